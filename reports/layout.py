"""Headings and entries: a table as every format prints it, before the format's own emphasis."""

from __future__ import annotations

from dataclasses import dataclass

from .columns import Column
from .decimals import rounded
from .summary import Cell, Row, Table

PUBLISHED_PLACES = 3  # the paper's
SUPERSCRIPTS = {1: "¹", 2: "²", 3: "³"}
LEGEND = "¹ ² ³ best to third after rounding, ties shared; ≈ its interval overlaps the best one's; ± over seeds"


@dataclass(frozen=True)
class Entry:
    text: str
    rank: int | None = None
    tied: bool = False
    number: bool = True
    sort: float | None = None  # what a column sorts by, where there is a number

    @property
    def marked(self) -> str:
        """The text with its marks, without emphasis."""
        return self.text + SUPERSCRIPTS.get(self.rank or 0, "") + (" ≈" if self.tied else "")


def headings(table: Table) -> list[str]:
    titles = ["method", "runs"]
    for column in table.columns:
        titles.append(f"{column.title} {column.arrow}" if column.ranked else column.title)
        if column.key in table.published:
            titles.append(f"{column.title} paper (Δ)")
    return titles


def explanations(table: Table) -> list[str]:
    """What each heading means."""
    texts = ["what was trained", "finished runs of all runs"]
    for column in table.columns:
        words = [column.axis, column.explanation, f"{column.better} is better" if column.ranked else ""]
        texts.append("; ".join(word for word in words if word))
        if column.key in table.published:
            texts.append(f"{column.axis}: the paper's, and ours minus it")
    return texts


def entries(table: Table, row: Row) -> list[Entry]:
    """One entry a heading."""
    line = [Entry(row.method, number=False), Entry(row.runs_text, number=False)]
    for column in table.columns:
        cell = row.cells.get(column.key)
        line.append(_entry(cell) if cell is not None else Entry(""))
        if column.key in table.published:
            theirs = row.published.get(column.key)
            line.append(Entry(published_text(row, column), sort=None if theirs is None else float(theirs)))
    return line


def _entry(cell: Cell) -> Entry:
    shown = cell.mean is not None and not (cell.averaged and not cell.complete)
    return Entry(cell.text, cell.rank, cell.tied, sort=float(cell.mean) if shown and cell.mean is not None else None)


def published_text(row: Row, column: Column) -> str:
    """ "27.220 (−0.135)": what the paper printed, and ours minus it."""
    if column.key not in row.published:
        return ""
    theirs = rounded(row.published[column.key], PUBLISHED_PLACES)
    ours = row.cells.get(column.key)
    if ours is None or not ours.complete or ours.mean is None:
        return str(theirs)
    return f"{theirs} ({rounded(ours.mean, PUBLISHED_PLACES) - theirs:+})".replace("-", "−")
