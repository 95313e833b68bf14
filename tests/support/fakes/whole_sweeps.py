"""Whole sweeps as processes, to be signaled and killed."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import psutil

from envgs_bench.records import Status
from envgs_bench.run_lock import holder_of
from envgs_bench.runs.processes import RUN_VARIABLE

from .runs import records

Start = Callable[..., "subprocess.Popen[str]"]


def alive(root: Path) -> list[psutil.Process]:
    """Processes of runs below `root`."""
    found = []
    for process in psutil.process_iter():
        try:
            if process.environ().get(RUN_VARIABLE, "").startswith(str(root)) and process.status() != "zombie":
                found.append(process)
        except psutil.Error:
            pass
    return found


def lives(number: int) -> bool:
    """Whether the process of this number is there, and not only waiting to be asked how it ended."""
    try:
        return psutil.Process(number).status() != "zombie"
    except psutil.NoSuchProcess:
        return False


def sweep_of(shell: subprocess.Popen[str]) -> psutil.Process:
    """The process of `envgs-bench run` itself."""
    first = psutil.Process(shell.pid)
    family = [first, *first.children(recursive=True)]
    return next(one for one in family if one.cmdline()[1:3] == ["-m", "envgs_bench.cli.main"])


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    ends = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < ends, "it did not come to that"
        time.sleep(0.05)


def training(root: Path) -> list[Path]:
    """The folders whose run is training at this moment."""
    folders = (root / "runs").glob("tiny/fake/*")
    return [folder for folder in folders if (at := holder_of(folder)) and at.progress.get("stage") == "training"]


def statuses(runs: Path) -> list[Status]:
    return sorted(record.status for record in records(runs)) if runs.is_dir() else []
