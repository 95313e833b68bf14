"""Run: one record and its folder. A record that cannot be read is listed, not fatal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from envgs_bench.records import RENDERS, Record, RecordError, find_runs, read_record
from envgs_bench.run_folder import LOG_NAME, RECORD_NAME
from envgs_bench.run_lock import holder_of

UNTIMED = "no device: pictures from elsewhere"
THREAD = "thread"  # of a processor, whose names end with how many it had


@dataclass(frozen=True)
class BrokenRecord:
    """A run folder without a usable record: it is missing, truncated or not a record."""

    path: Path
    reason: str


@dataclass(frozen=True)
class Run:
    """One run: its record, without the single frames' times, and the folder that holds its pictures."""

    folder: Path
    record: Record

    @property
    def ok(self) -> bool:
        return self.record.status == "ok"

    @property
    def device(self) -> str:
        """What the times were taken on: the device, and for a processor the number of threads too."""
        if self.record.kind == RENDERS:
            return UNTIMED
        device, threads = self.record.provenance.device, self.record.provenance.threads
        if isinstance(device, str):
            name, kind = device, device
        else:
            name, kind = str(device.get("name") or device.get("type") or "unknown device"), str(device.get("type", ""))
        if kind.startswith("cuda"):
            return name
        return f"{name}, {threads} {THREAD}{'s' * (threads != 1)}"

    def of_views(self, metric: str) -> dict[str, float]:
        """One score of each test view that has it."""
        metrics = self.record.metrics
        scores = {view.view: view.scores.get(metric) for view in metrics.per_view} if metrics else {}
        return {view: score for view, score in scores.items() if score is not None}


def is_processor(device: str) -> bool:
    """Whether what `Run.device` names is no GPU."""
    return device.removesuffix("s").endswith(f" {THREAD}")


def read_runs(
    folder: Path, only: Sequence[str] = (), exclude: Sequence[str] = ()
) -> tuple[list[Run], list[BrokenRecord]]:
    """Every run under `folder`, in the order of their paths, but those that somebody is running at this moment.

    Args:
        only, exclude: patterns with * and ?, of which a run matches some, where there are any, or none. They are held
            against its method, its data set, its status, `steps=<count>` and its path below `folder`; of a broken
            record the path.

    Raises:
        RecordError: `folder` is not there.
    """
    runs, broken = [], []
    for path in find_runs(folder):
        if not (path / RECORD_NAME).exists() and holder_of(path) is not None:
            continue
        place = path.relative_to(folder).as_posix()
        try:
            run = read_run(path)
        except RecordError as error:
            if _wanted([place], only, exclude):
                broken.append(BrokenRecord(path, str(error)))
            continue
        record = run.record
        if _wanted([place, record.method, record.dataset, record.status, f"steps={record.steps}"], only, exclude):
            runs.append(run)
    return runs, broken


def _wanted(names: Sequence[str], only: Sequence[str], exclude: Sequence[str]) -> bool:
    def matches(patterns: Sequence[str]) -> bool:
        return any(fnmatchcase(name, pattern) for name in names for pattern in patterns)

    return (not only or matches(only)) and not matches(exclude)


def read_run(folder: Path) -> Run:
    """The run in `folder`. Raises RecordError saying what is wrong with its record."""
    if not (folder / RECORD_NAME).exists():
        raise RecordError(f"{folder}: no {RECORD_NAME}: its process was killed; see its {LOG_NAME}")
    record = read_record(folder)
    if record.timing is not None:
        record = record.model_copy(update={"timing": record.timing.model_copy(update={"per_view": []})})
    return Run(folder, record)
