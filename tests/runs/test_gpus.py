"""Runs on a machine with several GPUs: each sees one, and they spread evenly, whoever starts them."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from multiprocessing.synchronize import Event
from pathlib import Path

import pytest
import torch

from envgs_bench import core
from envgs_bench.runs import gpus, job
from envgs_bench.settings import SettingsError


@pytest.fixture(autouse=True)
def folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


def seen(place: gpus.Place) -> str | None:
    return place.environment.get(gpus.VISIBLE)


def test_runs_spread_over_the_gpus_that_may_be_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(gpus.VISIBLE, "4,GPU-a1/b2, 7")
    with ExitStack() as others:
        places = [others.enter_context(gpus.placed("cuda")) for _ in range(7)]
        assert [seen(place) for place in places] == ["4", "GPU-a1/b2", "7"] * 2 + ["4"]
        with ExitStack() as one, gpus.placed("cuda") as second:
            assert seen(second) == "GPU-a1/b2"
            assert seen(one.enter_context(gpus.placed("cuda"))) == "7"
    with gpus.placed("cuda") as first:  # the others are gone
        assert seen(first) == "4"


def test_the_gpu_that_is_free_again_is_taken_next(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(gpus.VISIBLE, raising=False)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    with gpus.placed("cuda") as first:
        assert seen(first) == "0"
        for _ in range(2):
            with gpus.placed("cuda") as second:
                assert seen(second) == "1"


def test_a_gpu_is_taken_until_the_runs_process_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    """As when the sweep is killed: what it started goes on for a moment."""
    monkeypatch.setenv(gpus.VISIBLE, "0,1")
    with gpus.placed("cuda") as place:
        child = subprocess.Popen(
            [sys.executable, "-c", "input()"], stdin=subprocess.PIPE, text=True, pass_fds=place.handles
        )
    with gpus.placed("cuda") as next_one:
        assert seen(next_one) == "1"
    child.communicate("\n")
    with gpus.placed("cuda") as after:
        assert seen(after) == "0"


def _hold(tmp: str, ready: Event, end: Event) -> None:
    tempfile.tempdir = tmp
    with gpus.placed("cuda"):
        ready.set()
        end.wait(60)


def test_other_processes_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(gpus.VISIBLE, "0,1")
    context = multiprocessing.get_context("fork")
    ready, end = context.Event(), context.Event()
    process = context.Process(target=_hold, args=(str(tmp_path), ready, end))
    process.start()
    assert ready.wait(60)
    with gpus.placed("cuda") as place:
        assert seen(place) == "1"
    end.set()
    process.join()


def test_a_run_can_be_given_one_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(gpus.VISIBLE, "4,GPU-a1/b2, 7")
    monkeypatch.setattr(job, "has_driver", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(core, "available_backends", lambda: {"cuda": None})
    assert [job.resolve_device(wanted) for wanted in ("auto", "cuda", "cuda:2")] == ["cuda", "cuda", "cuda:2"]
    with gpus.placed("cuda:2") as chosen, gpus.placed("cuda:2") as again, gpus.placed("cuda") as free:
        assert [seen(place) for place in (chosen, again, free)] == ["7", "7", "4"]
    with pytest.raises(SettingsError, match="device=cuda:3: this machine shows 3 GPUs, the last one is cuda:2"):
        job.resolve_device("cuda:3")


@pytest.mark.parametrize(("device", "visible"), [("cpu", "0,1"), ("cuda", "3"), ("cuda", "")])
def test_where_there_is_nothing_to_choose_nothing_changes(
    device: str, visible: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(gpus.VISIBLE, visible)
    with gpus.placed(device) as place:
        assert place == gpus.Place()
    assert not list(tmp_path.iterdir())
