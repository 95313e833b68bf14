"""table.json: the tables with what stands behind every printed number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from ..numbers.runs import BrokenRecord
from .chapter import Chapter
from .columns import Column
from .table import Cell, Row, Table


def structured(chapters: Sequence[Chapter], broken: Sequence[BrokenRecord]) -> dict[str, Any]:
    """Plain JSON values. Numbers are in their column's printed unit and unrounded; `text` is what the tables print."""
    return {
        "sections": [
            {
                "title": chapter.section.title,
                "protocol": chapter.section.protocol.model_dump(),
                "scored_on": chapter.section.scored_on,
                "repair": list(chapter.section.repair),
                "device": chapter.section.device,
                "tables": [_table(table) for table in chapter.tables],
            }
            for chapter in chapters
        ],
        "unreadable": [{"path": str(item.path), "reason": item.reason} for item in broken],
    }


def _table(table: Table) -> dict[str, Any]:
    return {
        "title": table.title,
        "kind": table.kind,
        "datasets": list(table.datasets),
        "columns": [_column(column) for column in table.columns],
        "rows": [_row(row) for row in table.rows],
    }


def _column(column: Column) -> dict[str, Any]:
    names = ("key", "metric", "region", "group", "title", "places", "better", "axis", "explanation")
    return {name: getattr(column, name) for name in names}


def _row(row: Row) -> dict[str, Any]:
    return {
        "method": row.method,
        "runs": row.runs_text,
        "done": row.done,
        "attempts": row.attempts,
        **({"verdict": row.verdict, "taken": row.taken} if row.verdict else {}),
        "dropped_losses": [asdict(item) for item in row.dropped],
        "published": {key: float(value) for key, value in row.published.items()},
        "cells": {key: _cell(cell) for key, cell in row.cells.items()},
    }


def _cell(cell: Cell) -> dict[str, Any]:
    scale, estimate = float(cell.column.scale), cell.estimate
    return {
        "text": cell.text,
        "mean": None if cell.mean is None else float(cell.mean * cell.column.scale),
        "std": None if estimate.spread is None else scale * estimate.spread,
        "interval": None if cell.interval is None else [scale * end for end in cell.interval],
        "done": estimate.done,
        "expected": estimate.expected,
        "rank": cell.rank,
        "tied": cell.tied,
        "not_computed": estimate.not_computed,
    }
