"""Charts of a stability study: what each severity costs a method, and profiles over all perturbations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...charts.drawn import Canvas, DrawnChart
from ...charts.look import INK, RC, SOFT, open_axes, panel_axes
from ...charts.palette import Style
from ...numbers.estimates import Estimate
from ...tables.columns import PSNR, in_region
from .profiles import DROPS, drops, profile, survival
from .stability import Case, Stability

COLUMNS = 4  # panels in a row
WIDTH, HEIGHT = 3.1, 2.5  # a panel's with its margins, inches
LEGEND = 0.9  # inches above the panels
QUANTITIES = {"psnr": PSNR.axis, "psnr_reflective": in_region(PSNR, "reflective").axis}


def draw_stability(stability: Stability, style: dict[str, Style], canvas: Canvas, folder: str) -> list[DrawnChart]:
    """Write the dose-response curves of each data set and the profiles below `folder`.

    Args:
        style: of each of the methods.
    """
    written = []
    for number, dataset in enumerate(stability.datasets):
        cases = [case for case in stability.cases if case[0] == dataset]
        for quantity, axis in QUANTITIES.items():
            if any(_curve(stability, case, m, quantity) for case in cases for m in stability.methods_of(case)):
                draws = [_response(stability, case, quantity, style) for case in cases]
                name = f"{folder}/responses-{number}-{quantity}"
                title = f"{dataset}: {axis}, against severity"
                written.append(_write(draws, [kind for _, kind in cases], style, title, canvas, name))
    if stability.cases:
        titles = ["share of runs that lose at most so many dB", "share of runs that survive, by severity"]
        draws = [_profiles(stability, style), _survivals(stability, style)]
        written.append(_write(draws, titles, style, "profiles over all perturbations", canvas, f"{folder}/profiles"))
    return written


Draw = Callable[[Axes], None]


def _response(stability: Stability, case: Case, quantity: str, style: dict[str, Style]) -> Draw:
    def draw(axis: Axes) -> None:
        for method in stability.methods_of(case):
            _band(axis, _curve(stability, case, method, quantity), style[method])
        for index, method in enumerate(stability.methods_of(case)):
            heights = {s: float(at.mean) for s, at in _curve(stability, case, method, quantity) if at.mean is not None}
            for severity in stability.severities(case):
                cell = stability.cell(case, severity, method)
                if cell.failures:
                    words = f"{cell.failures}/{len(cell.tried)}"
                    _note_failures(axis, words, severity, heights.get(severity), style[method].color, index)
        severities = [0, *stability.severities(case)]
        axis.set_xticks(severities)
        axis.set_xlim(-0.05 * severities[-1], 1.05 * severities[-1])
        axis.set_xlabel("severity")

    return draw


def _note_failures(axis: Axes, words: str, x: float, y: float | None, color: str, line: int) -> None:
    """Above the mark, or, where no run finished, at the bottom, each method on a line of its own."""
    place, coordinates = ((x, y), axis.transData) if y is not None else ((x, 0.0), axis.get_xaxis_transform())
    offset = (0, 6) if y is not None else (0, 3 + 9 * line)
    where: dict[str, Any] = {"xycoords": coordinates, "textcoords": "offset points", "ha": "center"}
    axis.annotate(words, place, offset, fontsize=7, color=color, **where)


def _curve(stability: Stability, case: Case, method: str, quantity: str) -> list[tuple[float, Estimate]]:
    """(severity, value over the finished runs), unperturbed first; severities without a value are absent."""
    cells = [(float(s), stability.cell(case, s, method).values(quantity)) for s in (0, *stability.severities(case))]
    return [(severity, estimate) for severity, estimate in cells if estimate.mean is not None]


def _profiles(stability: Stability, style: dict[str, Style]) -> Draw:
    def draw(axis: Axes) -> None:
        for method in stability.methods:
            lost = drops(stability, method)
            curve = [(drop, profile(lost, drop)) for drop in DROPS] if lost else []
            _band(axis, curve, style[method], marks=False)
        axis.set_xlabel("drop from the unperturbed partner, dB")
        axis.set_ylim(-0.03, 1.03)

    return draw


def _survivals(stability: Stability, style: dict[str, Style]) -> Draw:
    severities = sorted({severity for case in stability.cases for severity in stability.severities(case)})

    def draw(axis: Axes) -> None:
        for method in stability.methods:
            curve = [(float(severity), survival(stability, method, severity)) for severity in severities]
            _band(axis, [(x, estimate) for x, estimate in curve if estimate.mean is not None], style[method])
        axis.set_xticks(severities)
        axis.set_xlabel("severity")
        axis.set_ylim(-0.03, 1.03)

    return draw


def _band(axis: Axes, points: Sequence[tuple[float, Estimate]], style: Style, marks: bool = True) -> None:
    xs = [x for x, _ in points]
    ys = [float(estimate.mean) for _, estimate in points if estimate.mean is not None]
    ends = [estimate.interval or (y, y) for y, (_, estimate) in zip(ys, points, strict=True)]
    axis.fill_between(xs, [low for low, _ in ends], [high for _, high in ends], color=style.color, alpha=0.18, lw=0)
    marker = style.marker if marks else "none"
    axis.plot(
        xs, ys, color=style.color, marker=marker, markersize=5, markeredgecolor=SOFT, markeredgewidth=0.6, linewidth=1.5
    )


def _write(
    draws: Sequence[Draw], names: Sequence[str], style: dict[str, Style], title: str, canvas: Canvas, stem: str
) -> DrawnChart:
    rows = -(-len(draws) // COLUMNS)
    columns = min(COLUMNS, len(draws))
    wide = WIDTH if len(draws) > 2 else 1.6 * WIDTH
    size = (max(columns * wide, 2 * WIDTH), rows * HEIGHT + LEGEND)
    with mpl.rc_context(RC | {"font.family": canvas.fonts, "font.size": 8}):
        figure = Figure(figsize=size, layout="constrained")
        figure.suptitle(_short(title, 80), x=0.01, ha="left", fontsize=11, color=INK)
        axes = panel_axes(figure, rows, columns, len(draws))
        for axis, draw, name in zip(axes, draws, names, strict=True):
            draw(axis)
            axis.set_title(_short(name, 44), loc="left", fontsize=9)
            open_axes(axis)
            axis.tick_params(length=0)
        lines = [mpl.lines.Line2D([], [], color=s.color, marker=s.marker, markersize=6) for s in style.values()]
        names_of = [_short(method, 30) for method in style]
        figure.legend(lines, names_of, loc="outside upper right", ncols=4, frameon=False, fontsize=8, labelcolor=SOFT)
        return canvas.write(figure, stem, title)


def _short(name: str, length: int) -> str:
    return name if len(name) <= length else name[: length - 1] + "…"
