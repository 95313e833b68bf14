"""The page's part on stability: what to expect, the failure matrix, curves, profiles and worst views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ...numbers.intervals import Interval
from ...page.tables import page_table
from ...tables.columns import PSNR
from ...tables.sections import Section
from ...tables.table import Table
from .breaking_points import BreakingPoint, breaking_points
from .corruption_error import mean_corruption_error
from .expectations import expectations
from .perturbed_runs import FAILURES, SURVIVED, UNTRIED, PerturbedRun
from .profiles import improvement_tasks, probability_of_improvement
from .stability import Case, Cell, Stability
from .table import CHANGE

GLYPHS = {
    SURVIVED: "✓",
    "collapsed": "↓",
    "exploded": "↑",
    "slow": "◔",
    "failed": "✕",
    "diverged": "∿",
    "out_of_memory": "▣",
    "timeout": "◷",
    "interrupted": "‖",
    "impossible": "∅",
}
NAMES = {SURVIVED: SURVIVED, **FAILURES, **UNTRIED}


def stability_data(section: Section, stability: Stability, tables: Sequence[Table]) -> dict[str, Any]:
    """What the template shows, as plain values."""
    sentences = expectations(stability)
    return {
        "datasets": [
            {
                "name": dataset,
                "sentences": [item for item in sentences if item.dataset == dataset],
                "methods": stability.methods,
                "matrix": _matrix(stability, dataset),
                "points": _points(stability, dataset),
            }
            for dataset in stability.datasets
        ],
        "improvements": _improvements(stability),
        "tables": [page_table(section, table) for table in tables],
        "failures": _failures(stability),
        "glyphs": [(GLYPHS[name], words) for name, words in NAMES.items()],
    }


def _matrix(stability: Stability, dataset: str) -> list[dict[str, Any]]:
    """A row a kind and severity, a cell a method."""
    rows = []
    for case in stability.cases:
        if case[0] == dataset:
            severities = stability.severities(case)
            for severity in severities:
                rows.append(
                    {
                        "kind": case[1],
                        "span": len(severities) if severity == severities[0] else 0,
                        "severity": severity,
                        "level": stability.level(case, severity),
                        "cells": [_cell(stability.cell(case, severity, method)) for method in stability.methods],
                    }
                )
    return rows


def _cell(cell: Cell) -> dict[str, Any]:
    change = cell.change("psnr")
    share = cell.failures / len(cell.tried) if cell.tried else 0.0
    warnings = [f"{kind.replace('_', ' ')} ×{count}" for kind, count in sorted(cell.warnings.items())]
    behind, compared = cell.behind
    return {
        "runs": [_run(run) for run in cell.runs],
        "change": "" if change.mean is None else CHANGE.text(change.mean),
        "interval": _interval(change.interval) if change.mean is not None else "",
        "class": "" if not cell.tried else "all" if share == 1 else "some" if share else "none",
        "failures": f"{cell.failures}/{len(cell.tried)}" if cell.failures else "",
        "silent": cell.silent,
        "warnings": ", ".join(warnings),
        "unpaired": cell.unpaired,
        "behind": f"{behind}/{compared}" if behind else "",
    }


def _run(run: PerturbedRun) -> dict[str, Any]:
    name = run.outcome
    words = f"seed {run.record.seed}: {NAMES[name]}"
    words += "" if run.paired else ", no finished partner"
    return {"glyph": GLYPHS[name], "survived": name == SURVIVED, "words": words}


def _points(stability: Stability, dataset: str) -> list[dict[str, Any]]:
    """Where each method's gain over the baseline is gone."""
    found = []
    for case in stability.cases:
        for method in stability.methods_of(case) if case[0] == dataset else ():
            points = breaking_points(stability, case, method)
            if points:
                found.append(
                    {
                        "kind": case[1],
                        "method": method,
                        "baseline": stability.baseline(case),
                        "gain": _gain(stability, case, method),
                        "points": [_point(point, stability.severities(case)) for point in points],
                        "seeds": points[0].seeds,
                    }
                )
    return found


def _gain(stability: Stability, case: Case, method: str) -> str:
    gain = stability.gain(case, 0, method)
    return "" if gain.mean is None else f"{PSNR.unsigned(gain.mean)} dB {_interval(gain.interval)}"


def _point(point: BreakingPoint, tried: Sequence[int]) -> str:
    def shown(severity: float) -> str:
        return f"beyond {tried[-1]}" if math.isinf(severity) else f"{severity:.1f}"

    if point.interval is None:
        return f"{shown(point.severity)} (one seed)"
    low, high = (shown(end) for end in point.interval)
    return f"{shown(point.severity)} ({low} to {high})" if (low, high) != (shown(point.severity),) * 2 else low


def _improvements(stability: Stability) -> list[str]:
    """A sentence a method that has a baseline to be compared with."""
    found = []
    for method in stability.methods:
        if tasks := improvement_tasks(stability, method):
            share, interval = probability_of_improvement(tasks)
            ends = f"95 % interval {100 * interval.low:.0f} to {100 * interval.high:.0f} %" if interval else "one seed"
            found.append(
                f"A perturbed run of {method} scores higher than one of its baseline with a probability of "
                f"{100 * share:.0f} % ({ends}, mean over {len(tasks)} perturbations; failed runs score lowest)."
            )
        if (error := mean_corruption_error(stability, method)) is not None:
            found.append(
                f"The mean corruption error of {method} is {error[0]:.2f} of its baseline's, over {error[1]} kinds of "
                "perturbation; of a failed run the error is 1."
            )
    return found


def _failures(stability: Stability) -> list[dict[str, Any]]:
    """Every perturbed run that did not finish, with what its record says."""
    found = []
    for case in stability.cases:
        for method in stability.methods_of(case):
            for severity in stability.severities(case):
                for run in stability.cell(case, severity, method).runs:
                    if (error := run.record.error) is not None:
                        found.append(
                            {
                                "run": f"{case[0]}, {case[1]} {severity}, {method}, seed {run.record.seed}",
                                "outcome": NAMES[run.outcome],
                                "message": str(error),
                            }
                        )
    return found


def _interval(interval: Interval | None) -> str:
    if interval is None:
        return "(one seed)"
    return f"[{interval.low:.2f}, {interval.high:.2f}]".replace("-", "−")
