"""Work beside a GPU's: all of it is done when its context is left, and what it raises is raised there."""

from __future__ import annotations

import threading

import pytest
import torch

from envgs_bench.stages import background
from envgs_bench.stages.background import Background

CPU, CUDA = torch.device("cpu"), torch.device("cuda")


@pytest.mark.parametrize(("device", "elsewhere"), [(CPU, False), (CUDA, True)])
def test_work_is_done_at_once_on_a_cpu_and_by_threads_beside_a_gpu(device: torch.device, elsewhere: bool) -> None:
    with Background(device) as work:
        found = [work.begin(threading.get_ident) for _ in range(40)]
    assert all(future.done() for future in found)
    assert all((future.result() != threading.get_ident()) == elsewhere for future in found)


def test_it_goes_on_while_its_owner_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(background.os, "cpu_count", lambda: 2)
    told = threading.Event()
    with Background(CUDA) as work:
        waiting = work.begin(told.wait, 60)
        assert not waiting.done()
        told.set()
    assert waiting.result()


@pytest.mark.parametrize("device", [CPU, CUDA])
def test_what_work_raises_is_raised(device: torch.device) -> None:
    def fail() -> None:
        raise OSError("no space left on device")

    with pytest.raises(OSError, match="no space"), Background(device) as work:
        work.begin(fail)


def test_an_owner_that_fails_is_heard_first() -> None:
    def fail() -> None:
        raise OSError("no space left on device")

    def own() -> None:
        with Background(CUDA) as work:
            work.begin(fail)
            raise ValueError("diverged")

    with pytest.raises(ValueError, match="diverged"):
        own()


def test_no_more_than_so_much_is_under_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(background, "UNDER_WAY", 2)
    with Background(CUDA) as work:
        found = [work.begin(int) for _ in range(5)]
        assert all(future.done() for future in found[:3])
