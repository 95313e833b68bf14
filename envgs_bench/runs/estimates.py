"""Estimates: how long a run may take, from those that ended."""

from __future__ import annotations

import statistics
from collections import defaultdict
from datetime import datetime
from pathlib import Path

from envgs_bench.records import Record, RecordError, find_runs, read_record
from envgs_bench.run_folder import RECORD_NAME
from envgs_bench.settings import RunSettings

GROWS_UNTIL = 0.5  # share of a run's steps after which models grow no more (3DGS's 15,000 of 30,000)
GROWN = 2.5  # a grown model's step, in first steps: the median over the demo's runs


class Estimates:
    """Seconds of runs by data set and method, from the finished records under `runs_dir`.

    The time of training grows with the steps, all else of a run does not. Where the data set has no record of the
    method, the median over all data sets stands in.
    """

    def __init__(self, runs_dir: Path) -> None:
        self._found: dict[tuple[str, ...], list[tuple[float, float]]] = defaultdict(list)
        for folder in find_runs(runs_dir) if runs_dir.is_dir() else []:
            if not (folder / RECORD_NAME).is_file():
                continue
            try:
                record = read_record(folder)
            except RecordError:
                continue
            if record.status == "ok":
                self._learn(record, *_names(folder.relative_to(runs_dir)))

    def seconds(self, settings: RunSettings) -> float | None:
        """What the run may take, None where no record tells."""
        device = settings.device
        for key in ((device, settings.method_name, settings.dataset_name), (device, settings.method_name)):
            if found := self._found.get(key):
                step = statistics.median(step for step, _ in found)
                return step * settings.steps + statistics.median(rest for _, rest in found)
        return None

    def _learn(self, record: Record, dataset: str, method: str) -> None:
        try:
            started, finished = (
                datetime.fromisoformat(getattr(record.provenance, at)) for at in ("started", "finished")
            )
            whole = (finished - started).total_seconds()
        except (ValueError, TypeError):
            return
        training = record.cost.train_seconds if record.cost else 0.0
        step = training / record.steps if record.steps else 0.0
        rest = max(0.0, whole - training)
        device = str(record.config.get("device"))
        for key in ((device, method, dataset), (device, method)):
            self._found[key].append((step, rest))


def _names(path: Path) -> tuple[str, str]:
    """The data set and the method of the run at `path` below runs_dir."""
    *dataset, method, _ = ("", "", *path.parts) if len(path.parts) < 3 else path.parts
    return "/".join(dataset), method


def training_left(seconds: float, first: int, step: int, steps: int) -> float:
    """Seconds that the steps after `step` may take, where those after `first` took so many so far.

    Steps become dearer as a model grows: until half of the run, when densification ends, a step's cost rises to
    `GROWN` times the first one's; then it stays.
    """
    done = _cost(step / steps) - _cost(first / steps)
    return seconds * (_cost(1.0) - _cost(step / steps)) / done if done > 0 else 0.0


def _cost(share: float) -> float:
    """What this share of a run's steps costs, in the cost of as many first steps; the integral of a step's cost."""
    growing = min(share, GROWS_UNTIL)
    return growing + (GROWN - 1) * growing**2 / (2 * GROWS_UNTIL) + GROWN * (share - growing)


def duration(seconds: float) -> str:
    """As people say it: 40 s, 12 min, 3 h 20 min."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
