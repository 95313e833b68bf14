"""Charts of budgets: quality against primitives with the knees marked, and base against environment as a map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

from envgs_bench.parts import BASE, ENV

from ...charts.drawn import Canvas, DrawnChart
from ...charts.look import INK, RC, SOFT, open_axes, panel_axes
from ...charts.palette import Style, styles
from ...tables.columns import SCORES, in_region
from ...tables.sections import Section
from .budgets import QUANTITIES, BudgetCurve, BudgetMap, Quantity

COLUMNS = 2  # panels in a row
WIDTH, HEIGHT = 4.8, 3.2  # a panel's with its margins, inches
LEGEND = 0.7  # inches above the panels
CELL, MARGIN = 0.62, 1.5  # a map's cell, and what stands around it, inches
NARROWEST = 6.2  # of a map, inches: its title has to fit
PRIMITIVES, BASE_COUNT, ENV_COUNT = (Quantity(n) for n in ("primitives", f"primitives_{BASE}", f"primitives_{ENV}"))


def draw_budgets(
    section: Section, curves: Sequence[BudgetCurve], maps: Sequence[BudgetMap], canvas: Canvas, folder: str
) -> list[DrawnChart]:
    """Write the curves of each data set and the maps below `folder` of the report."""
    style = styles(list(dict.fromkeys(curve.method for curve in curves)), section.cards)
    written = []
    for number, dataset in enumerate(section.datasets):
        own = [curve for curve in curves if curve.dataset == dataset]
        if own:
            written.append(_draw_curves(own, style, canvas, f"{folder}/curves-{number}"))
    for number, found in enumerate(maps):
        if found.best is not None:
            own = [c for c in curves if (c.dataset, c.method) == (found.dataset, found.method)]
            written.append(_draw_map(found, own, canvas, f"{folder}/map-{number}"))
    return written


def _draw_curves(curves: Sequence[BudgetCurve], style: dict[str, Style], canvas: Canvas, stem: str) -> DrawnChart:
    known = [q for q in QUANTITIES if any(c.estimate(row, q).mean is not None for c in curves for row in c.rows)]
    with mpl.rc_context(RC | {"font.family": canvas.fonts, "font.size": 8.5}):
        rows = max(1, -(-len(known) // COLUMNS))
        figure = Figure(figsize=(COLUMNS * WIDTH, rows * HEIGHT + LEGEND), layout="constrained")
        title = f"{curves[0].dataset}: quality against primitives"
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, color=INK)
        for axis, quantity in zip(panel_axes(figure, rows, COLUMNS, len(known)), known, strict=True):
            for curve in curves:
                _draw_curve(axis, curve, quantity, style[curve.method])
            axis.set_title(_axis_name(quantity), loc="left", fontsize=9)
            axis.set_xscale("log", base=2)
            axis.xaxis.set_major_formatter(FuncFormatter(lambda count, _: f"{count:,.0f}"))
            axis.set_xlabel("primitives")
            open_axes(axis)
            axis.tick_params(length=0)
        shown = {curve.method: style[curve.method] for curve in curves}
        lines = [mpl.lines.Line2D([], [], color=s.color, marker=s.marker, markersize=6) for s in shown.values()]
        ring = mpl.lines.Line2D([], [], **_ring(SOFT))
        figure.legend(
            [*lines, ring],
            [*shown, "knee"],
            loc="outside upper right",
            ncols=5,
            frameon=False,
            fontsize=8,
            labelcolor=SOFT,
        )
        return canvas.write(figure, stem, title)


def _draw_curve(axis: Axes, curve: BudgetCurve, quantity: Quantity, style: Style) -> None:
    """By the primitives that the models had, not by what they might have had."""
    points = []
    for row in curve.rows:
        count, estimate = curve.estimate(row, PRIMITIVES).mean, curve.estimate(row, quantity)
        if count and estimate.mean is not None:
            y = float(estimate.mean)
            points.append((float(count), y, *(estimate.interval or (y, y)), row == curve.knee.row))
    if not points:
        return
    xs, ys, low, high, knee = (np.array(values) for values in zip(*sorted(points), strict=True))
    axis.fill_between(xs, low, high, color=style.color, alpha=0.18, lw=0)
    axis.plot(
        xs,
        ys,
        color=style.color,
        marker=style.marker,
        markersize=5,
        markeredgecolor=SOFT,
        markeredgewidth=0.6,
        linewidth=1.5,
    )
    axis.plot(xs[knee], ys[knee], **_ring(style.color))


def _ring(color: str) -> dict[str, Any]:
    return {
        "linestyle": "none",
        "marker": "o",
        "markersize": 13,
        "markerfacecolor": "none",
        "markeredgecolor": color,
        "markeredgewidth": 1.6,
    }


def _draw_map(found: BudgetMap, curves: Sequence[BudgetCurve], canvas: Canvas, stem: str) -> DrawnChart:
    """PSNR in each cell; where the same method had a budget, what it made of that."""
    values = np.array(
        [[np.nan if (m := found.estimate(b, e).mean) is None else float(m) for b in found.base] for e in found.env]
    )
    size = (max(NARROWEST, CELL * len(found.base) * 1.25 + MARGIN + 1), CELL * len(found.env) + MARGIN)
    title = f"{found.dataset}, {found.method}: base × environment"
    with mpl.rc_context(RC | {"font.family": canvas.fonts, "font.size": 8.5}):
        figure = Figure(figsize=size, layout="constrained")
        figure.suptitle(title, x=0.01, ha="left", fontsize=9, color=INK)
        axis = figure.subplots()
        image = axis.imshow(values, origin="lower", cmap="viridis", aspect="auto")
        middle = (np.nanmin(values) + np.nanmax(values)) / 2
        for (row, column), value in np.ndenumerate(values):
            if np.isfinite(value):
                color = "black" if value > middle else "white"
                axis.text(column, row, f"{value:.2f}", ha="center", va="center", color=color)
        _frame(axis, found, found.best, "solid")
        _frame(axis, found, found.knee, "dashed")
        _mark_shares(axis, found, curves)
        axis.set_xticks(range(len(found.base)), [f"{limit:,}" for limit in found.base])
        axis.set_yticks(range(len(found.env)), [f"{limit:,}" for limit in found.env])
        axis.xaxis.set_minor_locator(NullLocator())
        axis.tick_params(length=0)
        axis.set_xlabel("base primitives, at most")
        axis.set_ylabel("environment primitives, at most")
        figure.colorbar(image, ax=axis, label="PSNR, dB")
        return canvas.write(figure, stem, title)


def _frame(axis: Axes, found: BudgetMap, at: tuple[int, int] | None, line: Literal["solid", "dashed"]) -> None:
    if at is None:
        return
    corner = (found.base.index(at[0]) - 0.5, found.env.index(at[1]) - 0.5)
    axis.add_patch(mpl.patches.Rectangle(corner, 1, 1, fill=False, edgecolor=INK, linewidth=2.5, linestyle=line))


def _mark_shares(axis: Axes, found: BudgetMap, curves: Sequence[BudgetCurve]) -> None:
    """Where budgets of the same method ended, between the map's size limits by their logarithms."""
    for curve in curves:
        for row in curve.rows:
            means = [curve.estimate(row, quantity).mean for quantity in (BASE_COUNT, ENV_COUNT)]
            counts = [math.nan if mean is None else float(mean) for mean in means]
            place = [_between(count, limits) for count, limits in zip(counts, (found.base, found.env), strict=True)]
            if not any(map(math.isnan, place)):
                axis.plot(*place, marker="D", markersize=7, color="white", markeredgecolor=INK, linestyle="none")


def _between(count: float, limits: Sequence[int]) -> float:
    """Where a count lies between the size limits' cells, by logarithms; NaN beyond the first or the last."""
    if not limits[0] <= count <= limits[-1]:
        return math.nan
    return float(np.interp(np.log2(count), np.log2(limits), range(len(limits))))


def _axis_name(quantity: Quantity) -> str:
    column = next(column for column in SCORES if column.metric == quantity.metric)
    return column.axis if quantity.region == "full" else in_region(column, quantity.region).axis
