"""The page's part on ladders: what to take for every scene, what each rung adds and costs, and the chart of both."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

from ..charts.ladder import LadderChart
from ..numbers.ladder import Ladder
from ..tables.columns import Column
from ..tables.ladder import KIND
from ..tables.notes import caption, notes
from ..tables.recommendations import recommendation
from ..tables.sections import Section
from ..tables.table import Cell, Row, Table
from .tables import number_and_spread


def ladder_data(section: Section, index: int, charts: Sequence[LadderChart]) -> dict[str, Any] | None:
    """What the template shows, as plain values; None where no data set has two rungs."""
    if not section.ladders:
        return None
    tables = [table for table in section.tables if table.kind == KIND]
    shown = [_table(section, *pair) for pair in zip(section.ladders, tables, strict=True)]
    shared = [note for note in shown[0]["notes"] if all(note in table["notes"] for table in shown)]
    for table in shown:
        table["notes"] = [note for note in table["notes"] if note not in shared]
    return {
        "recommendations": [recommendation(ladder) for ladder in section.ladders],
        "charts": charts,
        "tables": shown,
        "notes": shared,
        "csv": section.csv_name(index, "ladder"),
        "summary_csv": section.csv_name(index, "ladder-summary"),
    }


def _table(section: Section, ladder: Ladder, table: Table) -> dict[str, Any]:
    """A column a group of the table's: a score, below it what it gains; the differences to the best; the primitives."""
    groups = [list(members) for _, members in groupby(table.columns, key=lambda column: column.group or column.key)]
    return {
        "title": table.title,
        "caption": caption(section, table),
        "headings": [_heading(columns) for columns in groups],
        "rows": [_row(ladder, row, groups) for row in table.rows],
        "notes": [
            note for note in notes(section, table) if note not in table.remarks[:2]
        ],  # told above and in the rows
    }


def _heading(columns: Sequence[Column]) -> dict[str, str]:
    first = columns[0]
    return {
        "title": first.group or first.heading,
        "parts": ", ".join(column.title for column in columns) if first.group else "",
        "explanation": "; ".join(f"{column.title}: {column.explanation or column.axis}" for column in columns),
    }


def _row(ladder: Ladder, row: Row, groups: Sequence[Sequence[Column]]) -> dict[str, Any]:
    rung = next(rung for rung in ladder.rungs if rung.method == row.method)
    return {
        "method": row.method,
        "part": rung.part,
        "verdict": row.verdict,
        "taken": row.taken,
        "dropped": bool(row.dropped),
        "runs": row.runs_text,
        "failed": row.done < row.attempts,
        "cells": [_lines([row.cells[column.key] for column in columns]) for columns in groups],
    }


def _lines(cells: Sequence[Cell]) -> list[dict[str, str]]:
    """The cells below one another; of one alone the number above its spread."""
    lines = [dict(zip(("value", "spread"), number_and_spread(cell.text), strict=True)) for cell in cells]
    if len(lines) == 1 and lines[0]["spread"]:
        return [{"value": lines[0]["value"], "spread": ""}, {"value": lines[0]["spread"], "spread": ""}]
    return lines
