"""Against: a report's runs beside earlier ones, and every cell that left the band of its seeds, better or worse."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..numbers.cards import KNOWN
from ..numbers.intervals import interval_around
from ..numbers.runs import Run, read_runs
from ..tables.columns import FRAME_MS, TRAIN_SECONDS, Column, accuracy_columns
from .runs_file import IDENTITY, RunsFileError, read_kept, row_of

CELL = tuple(name for name in IDENTITY if name != "seed")  # what the runs of a cell have in common
TIMES = (FRAME_MS, TRAIN_SECONDS)  # they are shown where both took them on one device, and fail nobody's check
Direction = Literal["worse", "better"]


@dataclass(frozen=True)
class Change:
    """A cell that left its band.

    Attributes:
        cell: the values of CELL.
        column: the number's; None where runs have failed that had not, or no longer do.
        before, now: means over seeds, or shares of the runs that ended with status ok.
        band: how far the mean may move by the seeds alone, in the stored unit.
        seeds: how many runs there were, and are.
    """

    cell: tuple[str, ...]
    column: Column | None
    before: float
    now: float
    band: float
    seeds: tuple[int, int]

    @property
    def direction(self) -> Direction:
        higher = self.column is None or self.column.better == "higher"
        return "better" if (self.now > self.before) == higher else "worse"

    @property
    def counts(self) -> bool:
        """Whether somebody who asks if something got worse is to hear of it: a time may be the machine's."""
        return self.column not in TIMES


@dataclass(frozen=True)
class Against:
    """All that changed, of how many cells; and cells of which one side has no runs."""

    changes: list[Change]
    compared: int
    missing: list[tuple[str, ...]]  # cells of the earlier runs alone

    @property
    def got_worse(self) -> bool:
        return any(change.direction == "worse" and change.counts for change in self.changes)


def against(runs: Sequence[Run], earlier: Path) -> Against:
    """The runs beside earlier ones.

    A cell's band is Student's interval of the difference of both means (Welch's degrees of freedom), or, where one side
    has a single run, of the other's spread; of single runs on both sides it is half of the last printed decimal, which
    is the least of every band.

    Args:
        earlier: a CSV of kept runs, or a folder with runs.

    Raises:
        RunsFileError: no such file, or the folder holds no runs.
    """
    if earlier.is_dir():
        found, _ = read_runs(earlier)
        if not found:
            raise RunsFileError(f"{earlier}: holds no run to compare with; expected a runs_dir, or a CSV of kept runs")
        before = _frame(found)
    else:
        before = read_kept(earlier)
    now = _frame(runs)
    cells = dict(iter(before.groupby(list(CELL), sort=False)))
    others = dict(iter(now.groupby(list(CELL), sort=False))) if len(now) else {}
    changes: list[Change] = []
    compared = 0
    for cell, part in cells.items():
        if cell in others:
            for change in _compared(tuple(map(str, cell)), part, others[cell]):
                compared += 1
                changes += [change] if abs(change.now - change.before) > change.band else []
    changes.sort(key=lambda change: (change.direction, not change.counts, change.cell))
    return Against(changes[::-1], compared, [tuple(map(str, cell)) for cell in cells if cell not in others])


def _frame(runs: Sequence[Run]) -> pd.DataFrame:
    frame = pd.DataFrame([row_of(run) for run in runs])
    if not len(frame):
        return frame
    for name in ("steps", "seed"):
        frame[name] = pd.to_numeric(frame[name])
    return frame


def _compared(cell: tuple[str, ...], before: pd.DataFrame, now: pd.DataFrame) -> Iterator[Change]:
    """Every number that both sides have, changed or not."""
    was, share = (float((part["status"] == "ok").mean()) for part in (before, now))
    yield Change(cell, None, was, share, 0.0, (len(before), len(now)))
    for column in (*accuracy_columns(KNOWN), *TIMES):
        if column in TIMES and set(before["device"]) != set(now["device"]):
            continue
        found = [_values(part, column.key) for part in (before, now)]
        if all(map(len, found)):
            band = max(_band(*found), 0.5 * float(10.0**-column.places / float(column.scale)))
            yield Change(cell, column, float(found[0].mean()), float(found[1].mean()), band, tuple(map(len, found)))  # type: ignore[arg-type]


def _values(rows: pd.DataFrame, name: str) -> NDArray[np.float64]:
    if name not in rows:
        return np.empty(0)
    return pd.to_numeric(rows.loc[rows["status"] == "ok", name], errors="coerce").dropna().to_numpy(np.float64)


def _band(before: NDArray[np.float64], now: NDArray[np.float64]) -> float:
    """How far the difference of the means may be from 0 by chance."""
    spread = [values for values in (before, now) if len(values) > 1]
    if not spread:
        return 0.0
    # A single run is taken to spread as the other side's do.
    variances = np.array([(v if len(v) > 1 else spread[0]).var(ddof=1) / len(v) for v in (before, now)])
    freedom = np.array([len(v if len(v) > 1 else spread[0]) - 1 for v in (before, now)])
    return interval_around(0.0, variances, freedom)[1]


def as_table(found: Against) -> list[list[str]]:
    """A row a change, the worse ones first: direction, scene, method, number, before, now, band, runs."""
    rows = [["", "scene", "method", "number", "before", "now", "band", "runs"]]
    for change in found.changes:
        scene, method, *_ = change.cell
        column = change.column
        numbers = [change.before, change.now, change.band]
        if column is None:
            name, texts = "runs ok", [f"{change.before:.0%}", f"{change.now:.0%}", ""]
        else:
            name, texts = (
                column.title,
                [column.text(number) for number in numbers[:2]] + [f"± {column.text(numbers[2])}"],
            )
        rows.append([change.direction, scene, method, name, *texts, f"{change.seeds[0]}, {change.seeds[1]}"])
    return rows


def as_markdown(found: Against, earlier: Path) -> str:
    """The changes as a page."""
    rows = as_table(found)
    worse = sum(change.direction == "worse" for change in found.changes)
    lines = [
        f"# Beside {earlier.name}",
        "",
        f"{worse} cells are worse and {len(found.changes) - worse} better of {found.compared}, beyond the band of "
        "their seeds. Times count where both were taken on one device.",
        "",
    ]
    if len(rows) > 1:
        lines += [f"| {' | '.join(rows[0])} |", f"|{' --- |' * len(rows[0])}"]
        lines += [f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in rows[1:]]
    if found.missing:
        names = ", ".join(f"{scene} {method}" for scene, method, *_ in found.missing)
        lines += ["", f"Not run: {names}."]
    return "\n".join(lines) + "\n"
