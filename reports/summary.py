"""Cells, rows and tables: means over seeds, their spread, and who is best, computed from the tidy table alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import cached_property

import numpy as np
import pandas as pd

from envgs_bench.statistics import Interval, bootstrap_interval

from .columns import COST_COLUMNS, MAIN_COLUMNS, SUMMARY_COLUMNS, Column, region_columns
from .decimals import mean
from .published import PUBLISHED_METRICS, paper_method, published_means

Key = tuple[str, str, str, str]  # dataset, method, region, metric


@dataclass(frozen=True)
class Cell:
    """One number of one row: the mean over seeds (of one data set, or of the means of several)."""

    column: Column
    strata: tuple[tuple[float, ...], ...] = ()  # the stored values over seeds, one tuple a data set
    done: int = 0
    expected: int = 0  # `done` counts runs within one data set, data sets in an average over several
    averaged: bool = False  # over data sets
    not_computed: bool = False
    rank: int | None = None  # 1 to 3
    tied: bool = False  # its interval overlaps the best one's

    @cached_property
    def mean(self) -> Decimal | None:
        """In the stored unit, unrounded."""
        return mean(mean(values) for values in self.strata) if self.strata and all(self.strata) else None

    @property
    def spread(self) -> float | None:
        """Sample standard deviation over seeds, stored unit; None for one seed or several data sets."""
        if self.averaged or not self.strata or len(self.strata[0]) < 2:
            return None
        return float(np.std(self.strata[0], ddof=1))

    @cached_property
    def interval(self) -> Interval | None:
        return bootstrap_interval(self.strata)

    @property
    def complete(self) -> bool:
        return self.mean is not None and self.done == self.expected

    @property
    def text(self) -> str:
        """What every format prints for the number, before any emphasis."""
        if self.mean is None:
            return "n/c" if self.not_computed else "—"
        if self.averaged and not self.complete:
            return f"— ({self.done}/{self.expected})"
        spread = self.spread
        return self.column.text(self.mean) + (f" ± {self.column.text(spread)}" if spread is not None else "")


@dataclass(frozen=True)
class Row:
    method: str
    cells: dict[str, Cell]  # by the column's key; empty for a method that only the paper ran
    statuses: Counter[str] = field(default_factory=Counter)
    published: dict[str, Decimal] = field(default_factory=dict)  # the paper's psnr, ssim, lpips

    @property
    def done(self) -> int:
        return self.statuses["ok"]

    @property
    def attempts(self) -> int:
        return sum(self.statuses.values())

    @property
    def runs_text(self) -> str:
        """ "3/3", or "1/3: 2 diverged"."""
        if not self.statuses:
            return "published"
        failures = ", ".join(
            f"{count} {status.replace('_', ' ')}" for status, count in sorted(self.statuses.items()) if status != "ok"
        )
        return f"{self.done}/{self.attempts}" + (f": {failures}" if failures else "")


@dataclass(frozen=True)
class Table:
    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    datasets: tuple[str, ...]

    @property
    def published(self) -> set[str]:
        """The metrics of which some row has the paper's value."""
        return {metric for row in self.rows for metric in row.published}


class Numbers:
    """The tidy table and the attempts behind it, ready for look-up."""

    def __init__(self, tidy: pd.DataFrame, attempts: pd.DataFrame):
        keys = ["dataset", "method", "region", "metric"]
        self._values: dict[Key, list[float]] = {}
        self._known: set[Key] = set()
        for *key, value in tidy.sort_values("seed", kind="stable")[[*keys, "value"]].itertuples(index=False):
            self._known.add(tuple(key))
            if not np.isnan(value):
                self._values.setdefault(tuple(key), []).append(value)
        self._statuses: dict[tuple[str, str], Counter[str]] = {}
        for dataset, method, status in attempts[["dataset", "method", "status"]].itertuples(index=False):
            self._statuses.setdefault((dataset, method), Counter())[status] += 1

    def statuses(self, dataset: str, method: str) -> Counter[str]:
        return self._statuses.get((dataset, method), Counter())

    def regions(self, dataset: str) -> list[str]:
        """The data set's masked regions, by name."""
        return sorted({region for name, _, region, _ in self._known if name == dataset and region != "full"})

    def cell(self, column: Column, dataset: str, method: str) -> Cell:
        key = (dataset, method, column.region, column.metric)
        values = tuple(self._values.get(key, ()))
        return Cell(
            column,
            strata=(values,) if values else (),
            done=len(values),
            expected=sum(self.statuses(dataset, method).values()),
            not_computed=key in self._known and not values,
        )

    def average(self, column: Column, datasets: Sequence[str], method: str) -> Cell:
        """The unweighted mean of the data sets' means; complete only where every run of every data set finished."""
        cells = [self.cell(column, dataset, method) for dataset in datasets]
        return Cell(
            column,
            strata=tuple(values for cell in cells for values in cell.strata),
            done=sum(cell.complete for cell in cells),
            expected=len(cells),
            averaged=True,
            not_computed=any(cell.not_computed for cell in cells),
        )


def dataset_table(numbers: Numbers, dataset: str, methods: Iterable[str]) -> Table:
    """One data set's table: the methods that were tried, in the given order, and the columns that any of them has."""
    return _ranked_table(dataset, MAIN_COLUMNS, _rows(numbers, dataset, methods, MAIN_COLUMNS), (dataset,))


def region_table(numbers: Numbers, dataset: str, methods: Iterable[str]) -> Table | None:
    """Every score inside every region, in the layout of the paper's Table 2; None where no run has a region."""
    columns = tuple(column for region in numbers.regions(dataset) for column in region_columns(region))
    rows = _rows(numbers, dataset, methods, columns)
    table = _ranked_table(f"{dataset}: inside the regions", columns, rows, (dataset,))
    return table if table.columns else None


def average_table(numbers: Numbers, title: str, datasets: Sequence[str], methods: Iterable[str]) -> Table:
    """The averages over several data sets, in the layout of the paper's Table 1."""
    columns = (*SUMMARY_COLUMNS, *COST_COLUMNS)
    rows = []
    for method in methods:
        statuses = sum((numbers.statuses(dataset, method) for dataset in datasets), Counter[str]())
        if statuses:
            cells = {column.key: numbers.average(column, datasets, method) for column in columns}
            rows.append(Row(method, cells, statuses))
    return _ranked_table(title, columns, rows, tuple(datasets))


def with_published(table: Table) -> Table:
    """The table with the paper's values beside ours, and below it the methods that only the paper ran.

    The same table where a data set is not of the paper.
    """
    published: dict[str, dict[str, Decimal]] = {}
    for metric in PUBLISHED_METRICS:
        for method, value in published_means(table.datasets, metric).items():
            published.setdefault(method, {})[metric] = value
    if not published:
        return table
    rows = [replace(row, published=published.get(paper_method(row.method), {})) for row in table.rows]
    ours = {paper_method(row.method) for row in rows}
    rows += [Row(method, {}, published=values) for method, values in published.items() if method not in ours]
    return replace(table, rows=tuple(rows))


def _rows(numbers: Numbers, dataset: str, methods: Iterable[str], columns: Sequence[Column]) -> list[Row]:
    return [
        Row(method, {column.key: numbers.cell(column, dataset, method) for column in columns}, statuses)
        for method in methods
        if (statuses := numbers.statuses(dataset, method))
    ]


def _ranked_table(title: str, columns: Sequence[Column], rows: Sequence[Row], datasets: tuple[str, ...]) -> Table:
    """The table without its empty columns, best to third marked."""
    kept = tuple(column for column in columns if any(row.cells[column.key].text != "—" for row in rows))
    cells: list[dict[str, Cell]] = [{} for _ in rows]
    for column in kept:
        for row_cells, cell in zip(cells, _ranked([row.cells[column.key] for row in rows]), strict=True):
            row_cells[column.key] = cell
    return Table(title, kept, tuple(replace(row, cells=c) for row, c in zip(rows, cells, strict=True)), datasets)


def _ranked(cells: list[Cell]) -> list[Cell]:
    """Ranks by the printed number, ties shared (two firsts leave no second); incomplete cells compete for nothing."""
    column = cells[0].column if cells else None
    competing = [cell for cell in cells if cell.complete]
    if column is None or not column.ranked or len(competing) < 2:
        return cells
    sign = -1 if column.better == "higher" else 1
    printed = sorted(sign * _printed(cell) for cell in competing)
    best = [cell for cell in competing if sign * _printed(cell) == printed[0]]
    result = []
    for cell in cells:
        if cell.complete:
            place = printed.index(sign * _printed(cell)) + 1
            tied = place > 1 and any(_overlap(cell, other) for other in best)
            cell = replace(cell, rank=place if place <= 3 else None, tied=tied)
        result.append(cell)
    return result


def _overlap(a: Cell, b: Cell) -> bool:
    return a.interval is not None and b.interval is not None and a.interval.overlaps(b.interval)


def _printed(cell: Cell) -> Decimal:
    assert cell.mean is not None
    return cell.column.printed(cell.mean)
