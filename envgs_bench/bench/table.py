"""The benchmark's table, and how far the native backends are ahead of the oracle."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

Row = dict


def table(rows: Sequence[Row]) -> Table:
    """Rows as a table for the terminal, with µs a ray beside ms."""
    result = Table()
    for name in ("op", "direction", "backend"):
        result.add_column(name)
    numbers = ("primitives", "size", "median ms", "spread ms", "µs a ray", "hits a ray", "alpha", "peak MiB", "repeats")
    for name in numbers:
        result.add_column(name, justify="right")
    for row in rows:
        drawn = row["width"] is not None
        result.add_row(
            row["op"],
            row["direction"],
            row["backend"],
            f"{row['primitives']:,}",
            f"{row['width']}×{row['height']}" if drawn else "",
            f"{row['median_ms']:.2f}",
            f"{row['spread_ms']:.2f}",
            f"{us_per_ray(row):.2f}" if drawn else "",
            f"{row['hits_per_ray']:.1f}" if row["hits_per_ray"] is not None else "",
            f"{row['alpha']:.4f}" if drawn else "",
            f"{row['peak_bytes'] / 2**20:.0f}" if row["peak_bytes"] else "",
            str(row["repeats"]),
        )
    return result


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
