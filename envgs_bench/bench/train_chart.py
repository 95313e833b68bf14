"""A chart of PSNR against seconds of training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from envgs_bench.parts import MethodCard
from envgs_bench.reports.charts.chart_font import chart_fonts
from envgs_bench.reports.charts.drawn import write_figure
from envgs_bench.reports.charts.look import INK, RC, SOFT, open_axes, plain_numbers
from envgs_bench.reports.charts.palette import Style, styles

from .train import OURS, label_of

Row = dict[str, Any]

SIZE = (6.8, 4.2)  # inches


def draw_training(rows: Sequence[Row], stem: Path, cards: Mapping[str, MethodCard]) -> list[Path]:
    """Write <stem>.png and .pdf: a line a training, ours whole and others' dashed; each has its method's color.

    Args:
        cards: what methods say of themselves, by name.
    """
    lines: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        lines.setdefault((row["by"], row["method"]), []).append(row)
    style = styles(list(dict.fromkeys(method.removesuffix("_mcmc") for _, method in lines)), cards)
    first = rows[0]
    with mpl.rc_context(RC | {"font.family": chart_fonts()}):
        figure = Figure(figsize=SIZE, layout="constrained")
        figure.suptitle(f"{first['dataset']}, {first['device']}", x=0.01, ha="left", fontsize=11, color=INK)
        axis = figure.subplots()
        for (by, method), own in lines.items():
            axis.plot(
                [row["seconds"] for row in own],
                [row["psnr"] for row in own],
                label=label_of(by, method),
                **_look(by, method, style[method.removesuffix("_mcmc")]),
            )
        axis.set_xscale("log")
        plain_numbers(axis, LogLocator(subs=(1, 2, 5)))
        axis.set_xlabel("training, seconds (log)   ← less is better")
        axis.set_ylabel(f"PSNR of {first['views']} {first['scored_on']} views, dB   higher is better →")
        open_axes(axis)
        axis.tick_params(which="both", length=0)
        axis.legend(frameon=False, fontsize=8, labelcolor=SOFT)
        return write_figure(figure, stem)


def _look(by: str, method: str, style: Style) -> dict[str, Any]:
    line = "-" if by == OURS else ":" if method.endswith("_mcmc") else "--"
    edge = {"markeredgecolor": SOFT, "markeredgewidth": 0.6}
    return {"color": style.color, "marker": style.marker, "markersize": 5, "linewidth": 1.5, "linestyle": line, **edge}
