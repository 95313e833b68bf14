"""The charts as files: accuracy against what it costs, one row of panels a data set and device."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
from matplotlib.figure import Figure

from ..tables.columns import COSTS, FRAME_MS, PSNR, Column, accuracy_columns, in_region
from ..tables.sections import Section
from .drawn import Canvas, DrawnChart
from .look import GRAY, RC
from .pareto_panel import Panel, draw_panel, name_marks

MAX_ROWS = 4  # data sets drawn one by one; more are drawn as their means
WIDTH, HEIGHT = 5.6, 2.9  # a panel's, inches
LEFT, RIGHT, BOTTOM, TOP = 0.85, 0.2, 0.62, 0.72  # around it, for what stands beside its axes
REGIONS = ("near_field", "reflective", "foreground")  # the first that the data set has is drawn beside the full image


def draw_charts(sections: Sequence[Section], canvas: Canvas, every_pair: bool = False) -> list[DrawnChart]:
    """Write `pareto`: PSNR against frame time, of the full image and beside it of the most telling region.

    Args:
        every_pair: write charts/<accuracy>-<cost> too, for every pair of columns that has a point.

    Returns:
        What was drawn, nothing where no run finished.
    """
    jobs = {"pareto": _pareto_rows(sections)}
    known = {column.key: column for section in sections for column in accuracy_columns(section.metrics)}
    for accuracy in known.values() if every_pair else ():
        for cost in COSTS:
            jobs[f"charts/{accuracy.key}-{cost.key}"] = panel_rows(sections, cost, [accuracy])
    return [_write(rows, canvas, name) for name, rows in jobs.items() if rows]


def panel_rows(sections: Sequence[Section], cost: Column, accuracies: Sequence[Column]) -> list[list[Panel]]:
    """A row a data set, or a mean over several where there are many; a panel an accuracy that has a point."""
    rows = []
    for section in sections:
        alone = [table for table in section.subjects if len(table.datasets) == 1]
        means = [table for table in section.subjects if len(table.datasets) > 1]
        for table in alone if len(alone) <= MAX_ROWS else means:
            panels = [Panel(section, table, cost, accuracy) for accuracy in accuracies]
            rows.append([panel for panel in panels if panel.places])
    return [row for row in rows if row]


def _pareto_rows(sections: Sequence[Section]) -> list[list[Panel]]:
    telling = [in_region(PSNR, region) for region in REGIONS]
    return [row[:2] for row in panel_rows(sections, FRAME_MS, [PSNR, *telling])]


def _write(rows: list[list[Panel]], canvas: Canvas, stem: str) -> DrawnChart:
    with mpl.rc_context(RC | {"font.family": canvas.fonts}):
        return canvas.write(_figure(rows), stem)


def _figure(rows: list[list[Panel]]) -> Figure:
    columns = max(len(row) for row in rows)
    wide = WIDTH if columns == 1 else WIDTH * 0.78
    size = (columns * (wide + LEFT) + RIGHT, len(rows) * (HEIGHT + TOP + BOTTOM))
    figure = Figure(figsize=size)
    axes = figure.subplots(len(rows), columns, squeeze=False)
    figure.subplots_adjust(
        left=LEFT / size[0],
        right=1 - RIGHT / size[0],
        bottom=BOTTOM / size[1],
        top=1 - TOP / size[1],
        wspace=LEFT / wide,
        hspace=(TOP + BOTTOM) / HEIGHT,
    )
    for row, line in zip(rows, axes, strict=True):
        for axis in line[len(row) :]:
            axis.set_axis_off()
            axis.text(0.5, 0.5, "no masked region", transform=axis.transAxes, color=GRAY, ha="center")
        for column, (panel, axis) in enumerate(zip(row, line, strict=False)):
            draw_panel(axis, panel, first=column == 0)
    for row, line in zip(rows, axes, strict=True):
        for panel, axis in zip(row, line, strict=False):
            name_marks(figure, axis, panel)
    return figure
