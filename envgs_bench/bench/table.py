"""The benchmark's table, and how far the native backends are ahead of the oracle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.table import Table

Row = dict[str, Any]

WORDS = ("op", "direction", "backend")


def table(rows: Sequence[Row]) -> Table:
    """Rows as a table for the terminal, with rays a second; columns that no row has anything for are left out."""
    cells = [_cells(row) for row in rows]
    names = [name for name in (cells[0] if cells else ()) if name in WORDS or any(row[name] for row in cells)]
    result = Table(title=", ".join(dict.fromkeys(row["scene"] for row in rows)))
    for name in names:
        result.add_column(name, justify="left" if name in WORDS else "right")
    for row in cells:
        result.add_row(*(row[name] for name in names))
    return result


def _cells(row: Row) -> dict[str, str]:
    drawn = row["width"] is not None
    return {
        **{name: row[name] for name in WORDS},
        "primitives": f"{row['primitives']:,}" if row["primitives"] else "",
        "size": f"{row['width']}×{row['height']}" if drawn else "",
        "median ms": f"{row['median_ms']:.2f}",
        "spread ms": f"{row['spread_ms']:.2f}",
        "M rays a s": f"{1 / us_per_ray(row):.3g}" if drawn else "",
        "hits a ray": f"{row['hits_per_ray']:.1f}" if row["hits_per_ray"] is not None else "",
        "p50/p99/max": _distribution(row, "hits"),
        "tile lists p50/p99/max": _distribution(row, "lists"),
        "alpha": f"{row['alpha']:.4f}" if row["alpha"] is not None else "",
        "peak MiB": f"{row['peak_bytes'] / 2**20:.0f}" if row["peak_bytes"] else "",
        "B a primitive": f"{row['bytes_per_primitive']:.0f}" if row["bytes_per_primitive"] else "",
        "repeats": str(row["repeats"]),
    }


def _distribution(row: Row, name: str) -> str:
    values = [row[f"{name}_{part}"] for part in ("p50", "p99", "max")]
    return "" if None in values else "/".join(f"{value:.0f}" for value in values)


def us_per_ray(row: Row) -> float:
    return 1000 * row["median_ms"] / (row["width"] * row["height"])


def ratios(rows: Sequence[Row]) -> list[str]:
    """A line for each case that both the oracle and a native backend were timed on."""
    keys = ("op", "direction", "primitives", "width", "height")
    oracle = {tuple(row[key] for key in keys): row for row in rows if row["backend"] == "torch"}
    lines = []
    for row in rows:
        slow = oracle.get(tuple(row[key] for key in keys))
        if slow is None or row["backend"] not in ("cpu", "cuda"):
            continue
        lines.append(
            f"{row['op']} {row['direction']}, {row['primitives']:,} primitives, {row['width']}×{row['height']}: "
            f"{row['backend']} is {slow['median_ms'] / row['median_ms']:.0f} times as fast as the torch oracle"
        )
    return lines
