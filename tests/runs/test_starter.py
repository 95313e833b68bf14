"""Runs that are forked from a process that has imported all: found, ended and recorded as if started anew."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from fakes.runs import records, set_environment
from fakes.whole_sweeps import Start, alive, training, until

from envgs_bench.runs import started_run
from envgs_bench.runs.processes import RUN_VARIABLE
from envgs_bench.runs.started_run import StartedRun
from envgs_bench.runs.starter import IMPORTED

IMPORTS = """
import importlib, os, traceback
import torch
asked = []
for name in ("is_available", "device_count", "init", "_lazy_init", "get_device_capability", "get_device_properties"):
    setattr(torch.cuda, name, lambda *_, name=name: asked.append(name))
for name in {imported}:
    importlib.import_module(name)
print(asked, len(os.listdir("/proc/self/task")))
"""


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere nothing is forked")
def test_what_is_imported_asks_for_no_gpu_and_starts_no_thread() -> None:
    """After either a fork could not use the GPU, or would wait for a lock that nobody gives back.

    OpenBLAS is given one thread: it ends its own before a fork.
    """
    result = subprocess.run(
        [sys.executable, "-c", IMPORTS.format(imported=IMPORTED)],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_WAIT_POLICY": "PASSIVE", "OPENBLAS_NUM_THREADS": "1"},
    )
    assert result.stdout == "[] 1\n", result.stderr


def ended(folder: Path) -> tuple[int, str]:
    """How a run in `folder` ended, and what it said."""
    lock = os.open(folder / "lock.json", os.O_RDWR | os.O_CREAT)
    run = StartedRun(folder, lock, {}, ())
    os.close(lock)
    said = run.stderr.read().decode()
    return run.wait(60), said


def test_one_process_starts_all_runs_of_a_job_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(started_run, "_starter", None)
    for name in ("first", "second", "anew"):
        monkeypatch.setattr(started_run, "FORKS", started_run.FORKS and name != "anew")
        (tmp_path / name).mkdir()
        code, said = ended(tmp_path / name)
        assert code == 1
        assert str(tmp_path / name / "config.yaml") in said
        starter = started_run.starter_here()
        assert started_run.starter_here() is starter
    monkeypatch.setenv("OMP_NUM_THREADS", "3")  # libraries read it as they are loaded
    assert started_run.starter_here() is not starter
    assert starter.process.returncode is not None
    started_run.starter_here().end()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere nothing is forked, nor imported ahead")
@pytest.mark.parametrize(("ahead", "forks"), [(False, False), (False, True), (True, False)])
def test_no_run_that_begins_anew_waits_for_imports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ahead: bool, forks: bool
) -> None:
    monkeypatch.setattr(started_run, "_starter", None)
    monkeypatch.setattr(started_run, "FORKS", forks)
    starter = started_run.starter_here(ahead)
    ended(tmp_path)
    libraries = Path(f"/proc/{starter.process.pid}/maps").read_text()
    starter.end()
    assert ("libtorch" in libraries) == (ahead or forks)


def test_a_run_is_found_by_its_folder_and_ends_with_its_starter(tmp_path: Path, start: Start) -> None:
    process = start("method.kind=fakes.methods:Waits", "steps=1000")
    until(lambda: training(tmp_path))
    (run,) = alive(tmp_path)
    assert run.environ()[RUN_VARIABLE] == str(training(tmp_path)[0])
    starter = run.parent()
    assert isinstance(starter, psutil.Process)
    assert "envgs_bench.runs.starter" in starter.cmdline()
    starter.kill()
    process.communicate(timeout=60)
    assert process.returncode == 1
    assert alive(tmp_path) == []
    (record,) = records(tmp_path / "runs")
    assert record.status in ("out_of_memory", "interrupted")  # the run may have time to say so itself
