"""Processes of runs that are forked from this one, which has imported PyTorch already: a tenth of a new one's time."""

from __future__ import annotations

import os
import subprocess
import sys
import traceback
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch

from envgs_bench.runs import worker
from envgs_bench.runs.processes import JOB_VARIABLE, LOCK_VARIABLE, RUN_VARIABLE


@contextmanager
def forked_processes() -> Iterator[None]:
    """Within it, runs' processes are forked from this one: with signals, pipes and ends of their own."""
    with patch("envgs_bench.runs.process.StartedRun", _Forked), without_starter():
        yield


def without_starter() -> AbstractContextManager[object]:
    """Within it, no process begins to import PyTorch for runs that it is never asked for."""
    return patch("envgs_bench.runs.started_run.starter_here")


class _Forked(subprocess.Popen[bytes]):
    """A `StartedRun` without a starter: its command is never executed, its process does the work."""

    def __init__(self, folder: Path, lock: int, environment: Mapping[str, str], handles: tuple[int, ...]) -> None:
        own = {RUN_VARIABLE: str(folder), JOB_VARIABLE: str(os.getpid()), LOCK_VARIABLE: str(lock)}
        kept = (lock, *handles)
        super().__init__(
            [sys.executable],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
            pass_fds=kept,
            preexec_fn=partial(_work, folder, {**os.environ, **own, **environment}, kept),
        )

    def wait(self, timeout: float | None = None) -> int:
        try:
            return super().wait(timeout)
        except subprocess.TimeoutExpired:
            raise TimeoutError from None


def _work(folder: Path, env: Mapping[str, str], kept: Sequence[int]) -> None:
    """Be the worker of the run in `folder`; never returns."""
    code = 1
    try:
        _close_but({0, 1, 2, *kept})  # one of them tells Popen that the process is there
        os.environ.clear()
        os.environ.update(env)
        sys.stdout, sys.stderr = (os.fdopen(number, "w", buffering=1) for number in (1, 2))
        warnings.showwarning = _to_standard_error  # pytest collects them
        torch.set_num_threads(1)  # those that the parent had are not here
        code = worker.main([str(folder)])
    except BaseException:
        traceback.print_exc()
    worker.leave(code, folder)


def _to_standard_error(*given: Any) -> None:
    sys.stderr.write(warnings.formatwarning(*given[:4]))


def _close_but(kept: set[int]) -> None:
    for number in {int(name) for name in os.listdir("/proc/self/fd")} - kept:
        with suppress(OSError):  # the one that listed them
            os.close(number)
