"""Processes: how a run's process ends with the one that started it, and how all that came of it are ended."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from contextlib import suppress
from pathlib import Path

import psutil

RUN_VARIABLE = "ENVGS_BENCH_RUN"  # the run's folder, in the environment of its process and of all that it starts
JOB_VARIABLE = "ENVGS_BENCH_JOB"  # the number of the process that started it
LOCK_VARIABLE = "ENVGS_BENCH_RUN_LOCK"  # the lock's open file, which the run's process keeps, and nothing it starts
PR_SET_PDEATHSIG = 1  # of Linux's <sys/prctl.h>


def end_with(parent: int) -> None:
    """From now on this process gets SIGTERM when `parent`, the process that started it, ends in whatever way.

    Linux only; elsewhere a run notices at its next event that nobody reads it.
    """
    if sys.platform != "linux":
        return
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it ended before
        os.kill(os.getpid(), signal.SIGTERM)


def end_group(leader: int) -> None:
    """Kill the process group of `leader`, whether or not that one has ended."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(leader, signal.SIGKILL)


def end_all_of(folder: Path) -> None:
    """Kill every process that came of a run in `folder`, one that left its group too, but this one."""
    for process in psutil.process_iter():
        try:
            if process.pid != os.getpid() and process.environ().get(RUN_VARIABLE) == str(folder):
                process.kill()
        except (psutil.Error, OSError):
            continue
