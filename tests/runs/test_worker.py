"""What the worker makes of an exception."""

from __future__ import annotations

import signal
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from fakes.runs import records, run, set_environment

from envgs_bench.run_folder import SNAPSHOT_NAME
from envgs_bench.runs import process, worker
from envgs_bench.stages.health import Diverged


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (worker.TimeUp(), "timeout"),
        (KeyboardInterrupt(), "interrupted"),
        (BrokenPipeError(), "interrupted"),
        (Diverged(), "diverged"),
        (MemoryError(), "out_of_memory"),
        (torch.OutOfMemoryError("CUDA out of memory"), "out_of_memory"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory"), "out_of_memory"),
        (RuntimeError("shapes differ"), "failed"),
        (SystemExit(0), "failed"),
    ],
)
def test_every_exception_has_a_status(error: BaseException, status: str) -> None:
    assert worker._status(error) == status


def test_who_was_asked_to_end_and_failed_over_it_was_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_environment(monkeypatch)
    run(tmp_path, "method.kind=fakes.methods:FailsWhenAsked")
    (record,) = records(tmp_path)
    assert record.status == "interrupted"
    assert record.error is not None
    assert record.error.type == "KeyboardInterrupt"
    assert str(record.error) == "interrupted before anything was saved; the same command starts it again"
    assert "RecursionError: half of a module" in record.error.log_tail


def test_a_run_that_was_interrupted_before_it_began_saved_nothing(tmp_path: Path) -> None:
    """Its process still imported, and left no record: it was said to have been killed while it was saving."""
    draft = SimpleNamespace(folder=tmp_path)
    status, failure = process._diagnosis(-signal.SIGINT, draft, "interrupted")
    assert status == "interrupted"
    assert failure.message == "interrupted before anything was saved; the same command starts it again"
    (tmp_path / SNAPSHOT_NAME).touch()
    assert process._diagnosis(-signal.SIGKILL, draft, "interrupted")[1].message == "killed while it was saving"
