"""What all charts look like: their colors but those of methods, matplotlib's settings, and their axes."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, Locator, NullFormatter

INK, SOFT, GRID, GRAY = "#1f2733", "#667085", "#e8ebf0", "#a5adba"
RC: dict[Any, Any] = {
    "font.size": 9.5,
    "axes.edgecolor": "#98a2b3",
    "axes.linewidth": 0.8,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "pdf.fonttype": 42,  # publishers refuse type 3
    "text.parse_math": False,  # a name may hold a dollar sign
}


def panel_axes(figure: Figure, rows: int, columns: int, count: int) -> list[Axes]:
    """The first `count` of a grid of axes, row by row, with nothing where the others would be."""
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axis in axes[count:]:
        axis.set_axis_off()
    return axes[:count]


def open_axes(axis: Axes) -> None:
    """A grid behind what is drawn, and no frame above and to the right."""
    axis.grid(color=GRID, linewidth=0.8)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)


def plain_numbers(axis: Axes, locator: Locator) -> None:
    """A logarithmic x axis with numbers where `locator` says, written out: 0.5, 20, 1,000."""
    axis.xaxis.set_major_locator(locator)
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())
