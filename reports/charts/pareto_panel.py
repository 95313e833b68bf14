"""One panel of a chart: the methods of one data set in the plane of a cost and an accuracy."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator

from ..tables.columns import Column
from ..tables.sections import ALL, Section
from ..tables.table import Table
from .label_placement import Box, along, place_labels
from .look import GRAY, INK, SOFT, open_axes, plain_numbers
from .palette import Style, styles
from .pareto import Point, front, points

MAX_NAMED = 12  # points above this number may go without a name if they are dominated and there is no room


@dataclass(frozen=True)
class Panel:
    section: Section
    table: Table
    cost: Column
    accuracy: Column

    @property
    def places(self) -> list[Point]:
        """Those that a logarithmic axis of costs can show: a method without primitives is none of them."""
        return [point for point in points(self.table, self.cost, self.accuracy) if point.x > 0]


def draw_panel(axis: Axes, panel: Panel, first: bool) -> None:
    """The panel without its names; the first one of a row is titled."""
    places = panel.places
    best = front(places, panel.cost, panel.accuracy)
    style = styles(panel.section.methods, panel.section.cards)
    _staircase(axis, panel, best, places)
    _swept_lines(axis, panel, places)
    for point in places:
        _mark(axis, point, style[point.label], dominated=point.complete and point not in best)
    axis.set_xscale("log")
    _limits(axis, places)
    low, high = axis.get_xlim()
    plain_numbers(axis, LogLocator(subs=(1, 2, 5)) if high > 6 * low else MaxNLocator(5, steps=(1, 2, 5, 10)))
    open_axes(axis)
    axis.tick_params(which="both", length=0, pad=5)
    axis.set_xlabel(f"{panel.cost.axis} (log)   ← less is better")
    better = "higher is better →" if panel.accuracy.better == "higher" else "← lower is better"
    axis.set_ylabel(f"{panel.accuracy.axis}   {better}")
    failed = [row for row in panel.table.rows if row.attempts and not row.done]
    if failed:
        words = "no run finished: " + ", ".join(f"{_short(row.method)} (0/{row.attempts})" for row in failed)
        axis.text(1, 1.03, words, transform=axis.transAxes, fontsize=8.5, color=SOFT, ha="right")
    if first:
        count = len(panel.table.datasets)
        title = _short(panel.table.title, 44) + (f": mean of {count}" if count > 1 and panel.table.title != ALL else "")
        axis.set_title(title, loc="left", fontsize=13, pad=20)
        words = f"{panel.section.device}; {_basis(panel)}"
        axis.text(0, 1.03, words, transform=axis.transAxes, fontsize=8.5, color=SOFT)
    else:
        axis.set_title(panel.accuracy.title, loc="left", fontsize=13, pad=20)
        axis.text(0, 1.03, _basis(panel), transform=axis.transAxes, fontsize=8.5, color=SOFT)


def _basis(panel: Panel) -> str:
    """ "3 seeds, 800 steps": what the numbers are means of; the range where the methods' differ."""
    seeds = [row.done // len(panel.table.datasets) for row in panel.table.rows if row.done]
    runs = [item.run for dataset in panel.table.datasets for item in panel.section.of(dataset)]
    steps = [run.record.steps for run in runs if run.ok and run.record.steps]
    words = [_range(seeds, "seed")] if seeds else []
    return ", ".join(words + ([_range(steps, "step")] if steps else []))


def _range(counts: list[int], name: str) -> str:
    low, high = min(counts), max(counts)
    return f"{low:,} {name}{'s' * (low != 1)}" if low == high else f"{low:,} to {high:,} {name}s"


def _staircase(axis: Axes, panel: Panel, best: list[Point], places: list[Point]) -> None:
    """The front: what can be had at a given cost, and the area that is beaten."""
    if not best:
        return
    low = min(point.x for point in places) / 100, max(point.x for point in places) * 100
    xs = [best[0].x, *[point.x for point in best], low[1]]
    worst = -1e9 if panel.accuracy.better == "higher" else 1e9
    ys = [worst, *[point.y for point in best], best[-1].y]
    axis.step(xs, ys, where="post", color=INK, linewidth=1.3, alpha=0.75, zorder=2)
    axis.fill_between(xs, ys, worst, step="post", color="#f3f5f9", zorder=0, linewidth=0)


def _swept_lines(axis: Axes, panel: Panel, places: list[Point]) -> None:
    at = {point.label: point for point in places}
    for family in panel.section.sweeps:
        line = [at[label] for label in family if label in at]
        axis.plot([p.x for p in line], [p.y for p in line], color=SOFT, linewidth=1, linestyle=(0, (1, 1.5)), zorder=3)


def _mark(axis: Axes, point: Point, style: Style, dominated: bool) -> None:
    color = GRAY if dominated else style.color
    for interval, horizontal in ((point.x_interval, True), (point.y_interval, False)):
        if interval is not None:
            ends = (interval, (point.y, point.y)) if horizontal else ((point.x, point.x), interval)
            axis.plot(*ends, color=color, linewidth=1.4, solid_capstyle="round", zorder=4)
    hollow = not point.complete
    axis.plot(
        point.x,
        point.y,
        marker=style.marker,
        markersize=9.5 if style.marker != "D" else 8,
        markerfacecolor="white" if hollow else color,
        markeredgecolor=color if hollow else SOFT,
        markeredgewidth=1.8 if hollow else 0.7,
        linestyle="none",
        zorder=5,
    )


def _limits(axis: Axes, places: list[Point]) -> None:
    xs = [value for p in places for value in (p.x, *(p.x_interval or ())) if value > 0]
    ys = [value for p in places for value in (p.y, *(p.y_interval or ()))]
    ratio = max(max(xs) / min(xs), 1.6)
    margin = max(0.14 * (max(ys) - min(ys)), 0.008 * max(map(abs, ys)), 1e-6)
    axis.set_xlim(min(xs) / ratio**0.22, max(xs) * ratio**0.3)
    axis.set_ylim(min(ys) - 1.3 * margin, max(ys) + 1.3 * margin)


def name_marks(figure: Figure, axis: Axes, panel: Panel) -> None:
    """The methods' names beside their marks, dominated ones in gray, failures with their count."""
    places = panel.places
    best = front(places, panel.cost, panel.accuracy)
    texts = [
        axis.text(
            0,
            0,
            _short(p.label) + ("" if p.complete else f" ({p.done}/{p.attempts} runs)"),
            color=INK if p in best or not p.complete else SOFT,
            fontsize=10 if len(places) <= 8 else 7.5,
            zorder=6,
        )
        for p in places
    ]
    renderer = FigureCanvasAgg(figure).get_renderer()
    sizes = [(box.width, box.height) for box in (text.get_window_extent(renderer) for text in texts)]
    marks = [tuple(axis.transData.transform((p.x, p.y))) for p in places]
    area = axis.get_window_extent(renderer)
    frame = Box(area.x0, area.y0, area.x1, area.y1)
    points_px = figure.dpi / 72
    needed = [p in best or len(places) <= MAX_NAMED for p in places]
    boxes = place_labels(marks, sizes, needed, frame, _obstacles(axis, places, best), gap=9 * points_px)
    for text, box, mark in zip(texts, boxes, marks, strict=True):
        if box is None:
            text.remove()
            continue
        x, y = axis.transData.inverted().transform((box.left, box.bottom))
        text.set_position((float(x), float(y)))
        text.set_verticalalignment("bottom")
        _leader(axis, mark, box, 14 * points_px)


def _obstacles(axis: Axes, places: list[Point], best: list[Point]) -> list[Box]:
    lines = [[(x, p.y) for x in p.x_interval] for p in places if p.x_interval]
    lines += [[(p.x, y) for y in p.y_interval] for p in places if p.y_interval]
    stairs: list[tuple[float, float]] = []
    for point in best:
        if stairs:
            stairs.append((point.x, stairs[-1][1]))
        stairs.append((point.x, point.y))
    if stairs:
        stairs = [(stairs[0][0], axis.get_ylim()[0]), *stairs, (axis.get_xlim()[1], stairs[-1][1])]
    return [box for line in [*lines, stairs] for box in along([tuple(axis.transData.transform(p)) for p in line])]


def _leader(axis: Axes, mark: tuple[float, float], box: Box, reach: float) -> None:
    """A thin line to a label that had to go far from its mark."""
    nearest = (min(max(mark[0], box.left), box.right), min(max(mark[1], box.bottom), box.top))
    if (nearest[0] - mark[0]) ** 2 + (nearest[1] - mark[1]) ** 2 > reach**2:
        start, end = axis.transData.inverted().transform([mark, nearest])
        axis.plot([start[0], end[0]], [start[1], end[1]], color=GRAY, linewidth=0.7, zorder=3)


def _short(name: str, length: int = 30) -> str:
    return name if len(name) <= length else name[: length - 1] + "…"
