"""Charts of a population: speed against accuracy with a cloud of scenes, and differences against attributes."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from ...charts.drawn import Canvas, DrawnChart
from ...charts.look import GRAY, INK, RC, SOFT, open_axes, panel_axes, plain_numbers
from ...charts.palette import styles
from ...numbers.intervals import sample_interval
from ...tables.sections import Section
from .failure_map import FailureMap, Question
from .population import Population

COLUMNS, SHOWN = 3, 6  # panels of the failure map


def draw_population(
    section: Section, found: Population, mapped: FailureMap, canvas: Canvas, folder: str
) -> list[DrawnChart]:
    """Write both charts below `folder` of the report."""
    with mpl.rc_context(RC | {"font.family": canvas.fonts, "font.size": 8.5}):
        return [_draw_cloud(section, found, canvas, folder), _draw_map(found, mapped, canvas, folder)]


def _draw_cloud(section: Section, found: Population, canvas: Canvas, folder: str) -> DrawnChart:
    """Accuracy beside the mean of all methods on the same scene: scenes differ by more than methods do.

    Bars are 95 % intervals of the mean over scenes, those of times of the mean logarithm.
    """
    title = f"Speed against accuracy on {len(found.psnr)} scenes"
    style = styles(list(found.psnr.columns), section.cards)
    times = found.scores["frame_ms"].reindex(found.psnr.index)
    ahead = found.psnr.sub(found.psnr.mean(axis=1), axis=0)
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, color=INK)
    axis = figure.subplots()
    for method in found.psnr.columns:
        if method not in times or times[method].isna().all():
            continue
        own = style[method]
        axis.plot(times[method], ahead[method], ".", color=own.color, alpha=0.35, markersize=5)
        logs = np.log(times[method].dropna())
        middle = np.exp(logs.mean()), ahead[method].mean()
        if (across := sample_interval(logs.to_numpy())) and (up := sample_interval(ahead[method].to_numpy())):
            axis.plot(np.exp(across), [middle[1]] * 2, color=INK, linewidth=1.2)
            axis.plot([middle[0]] * 2, up, color=INK, linewidth=1.2)
        axis.plot(*middle, marker=own.marker, color=own.color, markersize=8, markeredgecolor=INK, label=method, ls="")
    axis.set_xscale("log")
    plain_numbers(axis, LogLocator(subs=(1, 2, 5)))
    axis.axhline(0, color=GRAY, linewidth=0.8)
    axis.set_xlabel("ms a frame (log)   ← less is better")
    axis.set_ylabel("PSNR beside the scene's mean over methods, dB")
    open_axes(axis)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8, labelcolor=SOFT)
    return canvas.write(figure, f"{folder}/cloud", title)


def _draw_map(found: Population, mapped: FailureMap, canvas: Canvas, folder: str) -> DrawnChart:
    """The difference against the attributes that go with it most; dotted is where the tree's first question parts."""
    title = f"{found.subject} less the best other method, by what scenes are like"
    margins = found.margins(found.subject)
    names = list(mapped.ranks.index[:SHOWN])
    rows = max(1, -(-len(names) // COLUMNS))
    figure = Figure(figsize=(9.6, 2.7 * rows + 0.5), layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, color=INK)
    for axis, name in zip(panel_axes(figure, rows, COLUMNS, len(names)), names, strict=True):
        values = found.attributes.loc[margins.index, name]
        for part, marker in (("choosing", "o"), ("judging", "s")):
            own = found.parts[margins.index] == part
            axis.plot(
                values[own], margins[own], marker, color=INK, alpha=0.55, markersize=4, ls="", label=f"for {part}"
            )
        axis.axhline(0, color=GRAY, linewidth=0.8)
        if isinstance(mapped.tree, Question) and mapped.tree.attribute == name:
            axis.axvline(mapped.tree.below, color=INK, linewidth=1, linestyle=":")
        axis.set_xlabel(f"{name.replace('_', ' ')}   (rank correlation {mapped.ranks[name]:+.2f})")
        axis.set_ylabel("dB")
        open_axes(axis)
    if len(found.used_parts) > 1:
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside right upper", frameon=False, fontsize=8, labelcolor=SOFT)
    return canvas.write(figure, f"{folder}/failure-map", title)
