"""The page's part on ablation ladders: what to take for every scene, and what each variant adds and costs."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

from ...page.tables import number_and_spread
from ...tables.columns import Column
from ...tables.notes import caption, notes
from ...tables.sections import Section
from ...tables.table import Cell, Row, Table
from .ladder import Ladder
from .recommendation import recommendation


def ladder_data(section: Section, ladders: Sequence[Ladder], tables: Sequence[Table]) -> dict[str, Any]:
    """What the template shows, as plain values."""
    shown = [_table(section, *pair) for pair in zip(ladders, tables, strict=True)]
    shared = [note for note in shown[0]["notes"] if all(note in table["notes"] for table in shown)]
    for table in shown:
        table["notes"] = [note for note in table["notes"] if note not in shared]
    return {"recommendations": list(map(recommendation, ladders)), "tables": shown, "notes": shared}


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
    variant = next(variant for variant in ladder.variants if variant.method == row.method)
    return {
        "method": row.method,
        "part": variant.part,
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
