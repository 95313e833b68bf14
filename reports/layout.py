"""Headings and entries: a table as every format prints it, before the format's own emphasis."""

from __future__ import annotations

from dataclasses import dataclass

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
        if column.key == "psnr" and table.published:
            titles.append("PSNR paper (Δ)")
    return titles


def explanations(table: Table) -> list[str]:
    """What each heading means."""
    texts = ["what was trained", "finished runs of all runs"]
    for column in table.columns:
        words = [column.axis, column.explanation, f"{column.better} is better" if column.ranked else ""]
        texts.append("; ".join(word for word in words if word))
        if column.key == "psnr" and table.published:
            texts.append("the paper's PSNR, dB, and ours minus it")
    return texts


def entries(table: Table, row: Row) -> list[Entry]:
    """One entry a heading."""
    line = [Entry(row.method, number=False), Entry(row.runs_text, number=False)]
    for column in table.columns:
        cell = row.cells.get(column.key)
        line.append(_entry(cell) if cell is not None else Entry(""))
        if column.key == "psnr" and table.published:
            line.append(Entry(published_text(row), sort=None if row.published is None else float(row.published)))
    return line


def _entry(cell: Cell) -> Entry:
    shown = cell.mean is not None and not (cell.averaged and not cell.complete)
    return Entry(cell.text, cell.rank, cell.tied, sort=float(cell.mean) if shown and cell.mean is not None else None)


def published_text(row: Row) -> str:
    """ "27.220 (−0.135)": what the paper printed, and ours minus it."""
    if row.published is None:
        return ""
    text = str(rounded(row.published, PUBLISHED_PLACES))
    ours = row.cells.get("psnr")
    if ours is None or not ours.complete or ours.mean is None:
        return text
    difference = rounded(ours.mean, PUBLISHED_PLACES) - rounded(row.published, PUBLISHED_PLACES)
    return f"{text} ({difference:+})".replace("-", "−")
