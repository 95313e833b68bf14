"""Headings and entries: a table as every format prints it, before the format's own emphasis."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal

from ..numbers.decimals import rounded
from .columns import Column
from .table import Cell, Row, Table

PUBLISHED_PLACES = 3  # the paper's
DAGGER = "†"  # on a method that trained without one of its losses
SUPERSCRIPTS = {1: "¹", 2: "²", 3: "³"}
LEGEND = (
    "¹ ² ³ best to third after rounding, ties shared; ≈ the same seeds do not show it to be worse than the best; "
    "± over seeds, unless it rounds to 0"
)


@dataclass(frozen=True)
class Entry:
    text: str
    rank: int | None = None
    tied: bool = False
    number: bool = True
    dropped: bool = False  # a method that trained without one of its losses
    taken: bool = False  # what a study recommends

    @property
    def marked(self) -> str:
        """The text with its marks, without emphasis."""
        return self.text + SUPERSCRIPTS.get(self.rank or 0, "") + DAGGER * self.dropped + " ≈" * self.tied


@dataclass(frozen=True)
class Heading:
    text: str
    explanation: str
    group: str = ""  # the heading above

    @property
    def full(self) -> str:
        """With the heading above, where there is one line for both."""
        return f"{self.group} {self.text}" if self.group else self.text


def headings(table: Table) -> list[Heading]:
    found = [Heading("method", "what was trained"), Heading("runs", "finished runs of all runs")]
    for column in table.columns:
        words = [column.axis, column.explanation, f"{column.better} is better" if column.ranked else ""]
        explanation = "; ".join(word for word in words if word)
        found.append(Heading(column.heading, explanation, column.group))
        if _beside(table, column):
            why = f"{column.axis}: the paper's, and ours minus it"
            found.append(Heading(f"{column.title} paper (Δ)", why, column.group))
    return found


def entries(table: Table, row: Row) -> list[Entry]:
    """One entry a heading."""
    method = Entry(row.method, number=False, dropped=bool(row.dropped), taken=row.taken)
    line = [method, Entry(row.runs_text, number=False)]
    for column in table.columns:
        printed = Entry("" if column.key not in row.published else published_text(row, column))
        if column.elsewhere:
            line.append(printed)
        else:
            cell = row.cells.get(column.key)
            line.append(_entry(cell) if cell is not None else Entry(""))
            line += [printed] if _beside(table, column) else []
    return line


def _beside(table: Table, column: Column) -> bool:
    """Whether the paper's values stand in a column of their own beside ours."""
    return column.key in table.published and not column.elsewhere


def _entry(cell: Cell) -> Entry:
    return Entry(cell.text, cell.rank, cell.tied)


def published_text(row: Row, column: Column) -> str:
    """ "27.220 (−0.135)": what the paper printed, and ours minus it."""
    value = row.published[column.key]
    if column.elsewhere and value < Decimal("0.01"):
        return f"1/{1 / value:,.0f}"  # as the paper prints frames that take hours
    places = min(PUBLISHED_PLACES, -int(value.as_tuple().exponent))  # fewer where a paper prints fewer
    theirs = rounded(value, places if not column.elsewhere else column.places)
    ours = row.cells.get(column.key)
    if ours is None or not ours.complete or ours.mean is None:
        return str(theirs)
    return f"{theirs} ({rounded(ours.mean, places) - theirs:+})".replace("-", "−")
