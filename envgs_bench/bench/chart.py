"""A chart of how cost grows with primitives, with pixels and with rays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

Row = dict

COLORS = {"trace": "tab:blue", "rasterize_2d": "tab:orange", "rasterize_3d": "tab:green", "build": "tab:gray"}
STYLES = {"forward": "-", "forward_backward": "--"}
BASE = {"trace": (160, 120), "rasterize_2d": (640, 480), "rasterize_3d": (640, 480), "build": (None, None)}
PRIMITIVES = 20_000


def draw_chart(rows: Sequence[Row], path: Path) -> None:
    """Three panels, logarithmic both ways: ms against primitives, against pixels, µs a ray against rays.

    Bars are the distance between the quartiles.
    """
    rows = [row for row in rows if row["op"] in COLORS]
    figure, (by_primitives, by_pixels, by_rays) = plt.subplots(1, 3, figsize=(15, 4.8), layout="constrained")
    base = [row for row in rows if (row["width"], row["height"]) == BASE[row["op"]]]
    _lines(by_primitives, base, lambda row: row["primitives"], lambda row: 1.0)
    by_primitives.set(xlabel="primitives", ylabel="ms", title="traced 160×120, rasterized 640×480")

    at_20k = [row for row in rows if row["primitives"] == PRIMITIVES and row["width"] is not None]
    _lines(by_pixels, [row for row in at_20k if row["op"] != "trace"], _pixels, lambda row: 1.0)
    by_pixels.set(xlabel="pixels", ylabel="ms", title=f"rasterized, {PRIMITIVES:,} primitives")

    _lines(by_rays, [row for row in at_20k if row["op"] == "trace"], _pixels, lambda row: 1000 / _pixels(row))
    by_rays.set(xlabel="rays", ylabel="µs a ray", title=f"traced, {PRIMITIVES:,} primitives")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _pixels(row: Row) -> int:
    return row["width"] * row["height"]


def _lines(axes: Axes, rows: Sequence[Row], x: Callable[[Row], float], factor: Callable[[Row], float]) -> None:
    """A line for each operation, direction and backend; `factor` turns milliseconds into the panel's unit."""
    groups = dict.fromkeys((row["backend"], row["op"], row["direction"]) for row in rows)
    for backend, op, direction in groups:
        own = sorted((r for r in rows if (r["backend"], r["op"], r["direction"]) == (backend, op, direction)), key=x)
        axes.errorbar(
            [x(row) for row in own],
            [row["median_ms"] * factor(row) for row in own],
            yerr=[row["spread_ms"] * factor(row) / 2 for row in own],
            color=COLORS[op],
            linestyle=STYLES[direction],
            marker="o" if backend in ("cpu", "cuda") else "x",
            markersize=4,
            capsize=2,
            label=f"{op} {direction.replace('_', ' + ')} ({backend})",
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(which="major", alpha=0.3)
    if groups:
        axes.legend(fontsize=7)
