"""The chart of the ladders: a panel a scene, what every variant adds to the one before, against its frame time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator

from ...charts.drawn import Canvas, DrawnChart
from ...charts.label_placement import Box, along, place_labels
from ...charts.look import GRAY, INK, RC, SOFT, open_axes, panel_axes, plain_numbers
from ...charts.palette import Style
from ...numbers.intervals import Interval
from ...tables.columns import FRAME_MS, PSNR
from .ladder import Ladder, Variant

PANELS = 12  # in one file
COLUMNS = 4  # panels in a row
WIDTHS = {1: 6.0, 2: 4.4, 3: 3.8}  # a panel's with its margins, inches; more in a row are narrower
WIDTH, HEIGHT = 3.4, 2.9
LEGEND_LINES = {True: 0.42, False: 0.58}  # inches above the panels, whether the legend fits into one line
ONE_LINE = 10  # inches: the width that it needs for that
LEFT, RIGHT, BOTTOM, TOP = 0.55, 0.15, 0.52, 0.48  # around each, inches
TITLE = "PSNR that each variant adds to the one before, against its frame time"
GAIN = replace(PSNR, against="the variant before")
RING: dict[str, Any] = {
    **{"marker": "o", "markerfacecolor": "none", "markeredgecolor": INK, "markeredgewidth": 1.4},
    "linestyle": "none",
}
SIZE_ON_PAGE = 98  # pixels an inch


@dataclass(frozen=True)
class Step:
    """A variant as it is drawn: `level` is the sum of what it and those before it add to the baseline, in dB."""

    variant: Variant
    frame_ms: float
    level: float
    added: float | None  # to the variant before; None for the baseline
    interval: Interval | None  # of what it adds


def steps(ladder: Ladder) -> list[Step]:
    """The variants of which runs finished, in order; one without seeds in common with that before is left out."""
    found: list[Step] = []
    for variant in ladder.variants:
        frame_ms, before = ladder.value(variant, "frame_ms").mean, ladder.before(variant)
        if frame_ms is None or not ladder.finished(variant):
            continue
        if before is None:
            found.append(Step(variant, float(frame_ms), 0.0, None, None))
            continue
        added = ladder.difference(variant, before, "psnr")
        under = next((step.level for step in found if step.variant == before), None)
        if added.mean is not None and under is not None:
            found.append(Step(variant, float(frame_ms), under + float(added.mean), float(added.mean), added.interval))
    return found


def draw_ladders(ladders: Sequence[Ladder], style: dict[str, Style], canvas: Canvas, stem: str) -> list[DrawnChart]:
    """Write the panels as `<stem>-<number>`, so many a file; none without a step to draw.

    Args:
        style: of each of the section's rows.
    """
    panels = [(ladder, found) for ladder in ladders if len(found := steps(ladder)) > 1]
    return [
        _write(panels[first : first + PANELS], style, canvas, f"{stem}-{first // PANELS}")
        for first in range(0, len(panels), PANELS)
    ]


def _write(panels: list[tuple[Ladder, list[Step]]], style: dict[str, Style], canvas: Canvas, stem: str) -> DrawnChart:
    columns = min(COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    wide = WIDTHS.get(columns, WIDTH)
    legend = LEGEND_LINES[columns * wide > ONE_LINE]
    size = (columns * wide, rows * HEIGHT + legend)
    with mpl.rc_context(RC | {"font.family": canvas.fonts, "font.size": 8}):
        figure = Figure(figsize=size)
        axes = panel_axes(figure, rows, columns, len(panels))
        figure.subplots_adjust(
            left=LEFT / size[0],
            right=1 - RIGHT / size[0],
            bottom=BOTTOM / size[1],
            top=1 - (TOP + legend) / size[1],
            wspace=(LEFT + RIGHT) / (wide - LEFT - RIGHT),
            hspace=(TOP + BOTTOM) / (HEIGHT - TOP - BOTTOM),
        )
        for axis, (ladder, found) in zip(axes, panels, strict=True):
            _panel(axis, ladder, found, style)
        for axis in axes[::columns]:
            axis.set_ylabel(f"{PSNR.title} over the baseline, dB")
        _legend(figure, panels, style)
        for axis, (_, found) in zip(axes, panels, strict=True):
            _name_steps(figure, axis, found)
        return canvas.write(figure, stem, TITLE, round(SIZE_ON_PAGE * size[0]))


def _panel(axis: Axes, ladder: Ladder, found: Sequence[Step], style: dict[str, Style]) -> None:
    axis.plot([s.frame_ms for s in found], [s.level for s in found], color=GRAY, linewidth=1.1, zorder=2)
    axis.axhline(0, color=GRAY, linewidth=0.8, linestyle=(0, (1, 2)), zorder=1)
    for step in found:
        color, marker = style[step.variant.method].color, style[step.variant.method].marker
        if step.interval is not None and step.added is not None:
            ends = [step.level - step.added + end for end in step.interval]
            axis.plot([step.frame_ms] * 2, ends, color=color, linewidth=1.5, marker="_", markersize=6, zorder=3)
        hollow = ladder.finished(step.variant) < ladder.attempts(step.variant)
        axis.plot(
            step.frame_ms,
            step.level,
            marker=marker,
            markersize=7.5,
            markerfacecolor="white" if hollow else color,
            markeredgecolor=color if hollow else SOFT,
            markeredgewidth=1.6 if hollow else 1.0,
            zorder=4,
        )
        if step.variant == ladder.recommended:
            axis.plot(step.frame_ms, step.level, markersize=15, zorder=5, **RING)
    _scales(axis, found)
    taken = ladder.recommended
    axis.set_title(_short(ladder.title, 44), loc="left", fontsize=9.5, pad=16)
    words = f"take {taken.method}" if taken else "no verdict"
    axis.text(0, 1.045, _short(words, 50), transform=axis.transAxes, fontsize=8, color=INK if taken else SOFT)


def _scales(axis: Axes, found: Sequence[Step]) -> None:
    xs = [step.frame_ms for step in found]
    ends = [step.level - step.added + end for step in found if step.added is not None for end in step.interval or ()]
    ys = [*(step.level for step in found), *ends]
    ratio = max(max(xs) / min(xs), 1.6)
    margin = max(0.2 * (max(ys) - min(ys)), 0.05)
    axis.set_xscale("log")
    axis.set_xlim(min(xs) / ratio**0.25, max(xs) * ratio**0.3)
    axis.set_ylim(min(ys) - margin, max(ys) + margin)
    wide = ratio > 4
    plain_numbers(axis, LogLocator(subs=(1, 2, 5)) if wide else MaxNLocator(4, steps=(1, 2, 5, 10)))
    open_axes(axis)
    axis.tick_params(which="both", length=0, pad=4)
    axis.set_xlabel(f"{FRAME_MS.axis} (log)")


def _legend(figure: Figure, panels: list[tuple[Ladder, list[Step]]], style: dict[str, Style]) -> None:
    """One entry a variant, whatever variant stands for it in a panel, and what the ring is."""
    drawn = {step.variant.name: step.variant for _, found in reversed(panels) for step in found}
    longest = max(panels, key=lambda panel: len(panel[1]))[1]
    ordered = dict.fromkeys([*(step.variant.name for step in longest), *drawn])
    marks = [(f"{drawn[name].method} ({drawn[name].part})", style[drawn[name].method]) for name in ordered]
    lines = [
        Line2D([], [], color=one.color, marker=one.marker, markersize=7, linestyle="none", label=_short(words, 46))
        for words, one in marks
    ]
    lines.append(Line2D([], [], label="taken", markersize=11, **RING))
    figure.legend(
        handles=lines,
        loc="upper left",
        bbox_to_anchor=(0.005, 1 - 0.04 / figure.get_figheight()),
        ncols=len(lines) if figure.get_figwidth() > ONE_LINE else 3,
        frameon=False,
        fontsize=8,
        labelcolor=SOFT,
        handletextpad=0.3,
        columnspacing=1.4,
    )


def _name_steps(figure: Figure, axis: Axes, found: Sequence[Step]) -> None:
    """What each variant adds to the one before, beside its mark."""
    texts = [axis.text(0, 0, _added(step), fontsize=8.5, color=INK, zorder=6) for step in found]
    renderer = FigureCanvasAgg(figure).get_renderer()
    sizes = [(box.width, box.height) for box in (text.get_window_extent(renderer) for text in texts)]
    to_pixels = axis.transData.transform
    marks = [tuple(to_pixels((step.frame_ms, step.level))) for step in found]
    area = axis.get_window_extent(renderer)
    lines = [tuple(to_pixels((step.frame_ms, step.level))) for step in found]
    boxes = place_labels(
        marks,
        sizes,
        [True] * len(found),
        Box(area.x0, area.y0, area.x1, area.y1),
        along(lines),
        gap=11 * figure.dpi / 72,
    )
    for text, box in zip(texts, boxes, strict=True):
        if box is not None:
            x, y = axis.transData.inverted().transform((box.left, box.bottom))
            text.set_position((float(x), float(y)))
            text.set_verticalalignment("bottom")


def _added(step: Step) -> str:
    return "" if step.added is None else GAIN.text(step.added)


def _short(name: str, length: int) -> str:
    return name if len(name) <= length else name[: length - 1] + "…"
