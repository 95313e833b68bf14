"""Points and their Pareto front: which methods no other method beats in both speed and accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..tables.columns import Column
from ..tables.table import Cell, Row, Table


@dataclass(frozen=True)
class Point:
    """A method in the plane of two columns, in their printed units."""

    label: str
    x: float
    y: float
    x_interval: tuple[float, float] | None
    y_interval: tuple[float, float] | None
    done: int
    attempts: int

    @property
    def complete(self) -> bool:
        """A method that failed somewhere is drawn hollow and beats nobody: its mean is over the easier runs."""
        return self.done == self.attempts


def points(table: Table, x: Column, y: Column) -> list[Point]:
    """The rows that have both values; rows without any finished run cannot be placed."""
    return [point for row in table.rows if (point := _point(row, x, y)) is not None]


def front(places: Sequence[Point], x: Column, y: Column) -> list[Point]:
    """The complete points that no complete point dominates, by increasing x.

    One dominates another if it is at least as good in both columns and better in one; equal points do not dominate.
    """
    x_sign, y_sign = (1 if column.better == "lower" else -1 for column in (x, y))
    competing = [(x_sign * point.x, y_sign * point.y, point) for point in places if point.complete]
    kept = [
        point for a, b, point in competing if not any(c <= a and d <= b and (c < a or d < b) for c, d, _ in competing)
    ]
    return sorted(kept, key=lambda point: point.x)


def _point(row: Row, x: Column, y: Column) -> Point | None:
    x_cell, y_cell = row.cells.get(x.key), row.cells.get(y.key)
    if x_cell is None or y_cell is None or x_cell.mean is None or y_cell.mean is None:
        return None
    if not (x_cell.shown and y_cell.shown):
        return None
    values = _value(x_cell), _value(y_cell), _interval(x_cell), _interval(y_cell)
    return Point(row.method, *values, row.done, row.attempts)


def _value(cell: Cell) -> float:
    assert cell.mean is not None
    return float(cell.mean * cell.column.scale)


def _interval(cell: Cell) -> tuple[float, float] | None:
    scale = float(cell.column.scale)
    return None if cell.interval is None else (cell.interval[0] * scale, cell.interval[1] * scale)
