"""Overview: what has become of every run in a folder, and how far those have come that somebody is running."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from envgs_bench.records import RecordError, find_runs, read_record
from envgs_bench.run_folder import RECORD_NAME, REPLACEMENT, SNAPSHOT_NAME
from envgs_bench.run_lock import Holder, holder_of

from .estimates import duration, training_left

UNDER_WAY, WAITING, UNREADABLE = "running", "killed", "unreadable"


@dataclass(frozen=True)
class RunState:
    """One run. `state` is its record's status, or running, killed (its process left no record) or unreadable."""

    folder: Path
    state: str
    message: str = ""
    holder: Holder | None = None

    @property
    def progress(self) -> str:
        """How far a running one has come: its stage, its step of how many, and the seconds that are left of it."""
        if self.holder is None:
            return ""
        event = self.holder.progress
        stage, step, steps = event.get("stage", "starting"), event.get("step"), event.get("steps")
        if not isinstance(step, int) or not isinstance(steps, int) or not steps:
            return str(stage)
        done, left = step - int(event.get("first", 0)), ""
        if done > 0 and step < steps:
            so_far = max(0.0, float(event.get("at", 0)) - float(event.get("began", 0)))
            linear = so_far / done * (steps - step)
            seconds = training_left(so_far, step - done, step, steps) if stage == "training" else linear
            left = f", about {duration(seconds)} left"
        return f"{stage} {step}/{steps}{left}"

    @property
    def silent_seconds(self) -> float:
        """How long a running one has reported nothing."""
        return max(0.0, time.time() - float(self.holder.progress.get("at", 0))) if self.holder else 0.0


def overview(runs: Path) -> list[RunState]:
    """The state of every run under `runs`, in the order of their paths.

    Raises:
        RecordError: `runs` is no folder.
    """
    return [_state(folder) for folder in find_runs(runs)]


def _state(folder: Path) -> RunState:
    holder = holder_of(folder)
    if holder is not None:
        again = " again" if (folder / REPLACEMENT).is_dir() else ""
        return RunState(folder, UNDER_WAY + again, holder=holder)
    if not (folder / RECORD_NAME).exists():
        saved = "goes on from its snapshot" if (folder / SNAPSHOT_NAME).is_file() else "starts again"
        return RunState(folder, WAITING, f"left no record; the same command {saved}")
    try:
        record = read_record(folder)
    except RecordError as error:
        return RunState(folder, UNREADABLE, str(error))
    return RunState(folder, record.status, str(record.error or ""))
