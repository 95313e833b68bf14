"""Table: rows of methods, columns of numbers, who is best, and what the paper printed beside."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import cached_property

from ..numbers.comparison import compare
from ..numbers.estimates import Estimate, Numbers
from ..numbers.intervals import Interval
from ..numbers.published import PROTOCOL, Source, published_source, published_values
from .columns import Column

Kind = str  # what a table is for: a key of layouts.LAYOUTS, or a study's name


@dataclass(frozen=True)
class Cell:
    """One number of one row, as its column prints it."""

    column: Column
    estimate: Estimate
    rank: int | None = None  # 1 to 3
    tied: bool = False  # pairs of seeds do not show it to be worse than the best

    @property
    def mean(self) -> Decimal | None:
        """In the stored unit, unrounded."""
        return self.estimate.mean

    @property
    def interval(self) -> Interval | None:
        """In the stored unit."""
        return self.estimate.interval

    @property
    def complete(self) -> bool:
        return self.estimate.complete

    @property
    def shown(self) -> bool:
        """Whether the mean is printed: one over a part of several data sets would compare with nothing."""
        return self.mean is not None and (self.complete or not self.estimate.averaged)

    @cached_property
    def text(self) -> str:
        """What every format prints for the number, before any emphasis."""
        if self.mean is None:
            return "n/c" if self.estimate.not_computed else "—"
        if not self.shown:
            return f"— ({self.estimate.done}/{self.estimate.expected})"
        spread = self.estimate.spread
        text = self.column.text(self.mean)
        if self.column.with_interval:
            return text if self.interval is None else f"{text} {self.column.ends(self.interval)}"
        if spread is None or self.column.printed(spread) == 0:
            return text
        return f"{text} ± {self.column.unsigned(spread)}"


@dataclass(frozen=True)
class DroppedLoss:
    """A loss that the settings of a row's method ask for and that finished runs on a data set trained without."""

    loss: str
    why: str
    dataset: str
    runs: int  # finished runs that trained without it
    done: int  # all finished runs


@dataclass(frozen=True)
class Row:
    method: str
    cells: dict[str, Cell]  # by the column's key; empty for a method that only the paper ran
    statuses: Counter[str] = field(default_factory=Counter)
    published: dict[str, Decimal] = field(default_factory=dict)  # by the column's key: what the paper printed
    source: Source | None = None  # where the paper prints a row that is its alone
    dropped: tuple[DroppedLoss, ...] = ()
    verdict: str = ""  # what a study says of it, in words
    taken: bool = False  # a study's recommendation

    @property
    def done(self) -> int:
        return self.statuses["ok"]

    @property
    def attempts(self) -> int:
        return self.statuses.total()

    @property
    def runs_text(self) -> str:
        """ "3/3", "1/3: 2 diverged", or "published"."""
        if not self.statuses:
            return "published" + (", not real-time" if self.source == "non_realtime" else "")
        failures = ", ".join(
            f"{count} {status.replace('_', ' ')}" for status, count in sorted(self.statuses.items()) if status != "ok"
        )
        return f"{self.done}/{self.attempts}" + (f": {failures}" if failures else "")


@dataclass(frozen=True)
class Table:
    title: str
    kind: Kind
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    datasets: tuple[str, ...]
    told: str = ""  # its caption, where that is not about the data sets' unperturbed runs
    remarks: tuple[str, ...] = ()  # notes of its own, after those on the data sets' unperturbed runs

    @property
    def published(self) -> set[str]:
        """The keys of the columns of which some row has the paper's value."""
        return {key for row in self.rows for key in row.published}


def build_table(
    numbers: Numbers,
    title: str,
    kind: Kind,
    columns: Sequence[Column],
    methods: Iterable[str],
    names: Mapping[str, str] | None = None,
    paper: Callable[[str], bool] = lambda method: True,
    protocol: str = PROTOCOL,
) -> Table:
    """The methods that were tried on the columns' data sets, in the given order, without columns that have no number.

    Args:
        names: row -> the paper's name of it; None leaves the paper out altogether.
        paper: which of the paper's methods may have a row of their own.
        protocol: under which the runs are scored, where the paper is not left out.
    """
    datasets = tuple(dict.fromkeys(name for column in columns for name in column.datasets))
    rows = []
    for method in methods:
        statuses = numbers.statuses(datasets, method)
        if statuses:
            cells = {c.key: _cell(numbers, c, method) for c in columns if not c.elsewhere}
            rows.append(Row(method, cells, statuses))
    if names is not None:
        rows = _beside_paper(rows, columns, names, paper, protocol)
    kept = with_numbers(columns, rows)
    marked: list[dict[str, Cell]] = [{} for _ in rows]
    for column in kept:
        own = {row.method: cell for row in rows if (cell := row.cells.get(column.key)) is not None}
        ranked = _ranked(numbers, column, own)
        for cells, row in zip(marked, rows, strict=True):
            if row.method in ranked:
                cells[column.key] = ranked[row.method]
    return Table(title, kind, kept, tuple(replace(r, cells=c) for r, c in zip(rows, marked, strict=True)), datasets)


def _cell(numbers: Numbers, column: Column, method: str) -> Cell:
    return Cell(column, numbers.estimate(column.datasets, method, column.region, column.metric, column.against))


def with_numbers(columns: Iterable[Column], rows: Sequence[Row]) -> tuple[Column, ...]:
    """The columns of which some row has a number, ours or the paper's."""
    return tuple(column for column in columns if any(_has(row, column.key) for row in rows))


def _has(row: Row, key: str) -> bool:
    return key in row.published or (key in row.cells and row.cells[key].text != "—")


def _beside_paper(
    rows: list[Row],
    columns: Sequence[Column],
    names: Mapping[str, str],
    wanted: Callable[[str], bool],
    protocol: str,
) -> list[Row]:
    """The rows with the paper's values beside them, and below them the methods that only the paper ran."""
    published: dict[str, dict[str, Decimal]] = {}
    for column in columns:
        for method, value in published_values(column.datasets, column.region, column.metric, protocol).items():
            if not column.against:
                published.setdefault(method, {})[column.key] = value
    rows = [replace(row, published=published.get(names[row.method], {})) for row in rows]
    ours = {names[row.method] for row in rows}
    others = [(method, values) for method, values in published.items() if method not in ours]
    return rows + [
        Row(method, {}, published=values, source=published_source(method))
        for method, values in others
        if wanted(method)
    ]


def _ranked(numbers: Numbers, column: Column, cells: Mapping[str, Cell]) -> dict[str, Cell]:
    """Ranks by the printed number, ties shared (two firsts leave no second); incomplete cells compete for nothing."""
    competing = {method: cell for method, cell in cells.items() if cell.complete}
    if not column.ranked or len(competing) < 2:
        return dict(cells)
    sign = 1 if column.better == "higher" else -1
    printed = sorted((sign * _printed(cell) for cell in competing.values()), reverse=True)
    best = [method for method, cell in competing.items() if sign * _printed(cell) == printed[0]]
    result = dict(cells)
    for method, cell in competing.items():
        place = printed.index(sign * _printed(cell)) + 1
        where = (column.datasets, method)
        tied = place > 1 and any(compare(numbers, *where, o, column.metric, column.region, sign).tied for o in best)
        result[method] = replace(cell, rank=place if place <= 3 else None, tied=tied)
    return result


def _printed(cell: Cell) -> Decimal:
    assert cell.mean is not None
    return cell.column.printed(cell.mean)
