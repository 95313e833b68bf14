"""Profiles over all perturbations: how many runs lose how much, and how likely a method beats another.

After Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice": performance profiles
and the probability of improvement, over tasks (here a data set, kind and severity) with few seeds each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from ...numbers.estimates import Estimate
from ...numbers.intervals import Interval, interval_around
from .perturbed_runs import value
from .stability import Stability

DROPS = tuple(0.25 * step for step in range(41))  # dB, at which profiles are taken


class Share(Estimate):
    """An estimate that is a share: its interval ends where shares do."""

    @cached_property
    def interval(self) -> Interval | None:
        interval = super().interval
        return None if interval is None else interval.within(0.0, 1.0)


def drops(stability: Stability, method: str) -> list[list[float]]:
    """A list a task: the drop in PSNR of each of the method's perturbed runs, infinite where it did not finish."""
    found = []
    for case in stability.cases:
        for severity in stability.severities(case):
            tried = [t for t in stability.cell(case, severity, method).tried if t.paired]
            lost = [math.inf if not t.run.ok else t.drop("psnr") for t in tried]
            if known := [drop for drop in lost if drop is not None]:
                found.append(known)
    return found


def profile(tasks: Sequence[Sequence[float]], most: float) -> Share:
    """The share of runs that lose at most so many dB, every task counting alike."""
    shares = tuple(tuple(float(drop <= most) for drop in task) for task in tasks)
    return Share(strata=shares, done=len(shares), expected=len(shares), averaged=True)


def survival(stability: Stability, method: str, severity: int) -> Share:
    """The share of runs that survive their gates at a severity, every data set and kind counting alike."""
    cells = [stability.cell(case, severity, method) for case in stability.cases]
    shares = tuple(tuple(float(not run.failed) for run in cell.tried) for cell in cells if cell.tried)
    return Share(strata=shares, done=len(shares), expected=len(shares), averaged=True)


def probability_of_improvement(
    tasks: Sequence[tuple[Sequence[float], Sequence[float]]],
) -> tuple[float, Interval | None]:
    """That a run of the first method scores higher than one of the second, a draw counting as half.

    Args:
        tasks: (scores of the first, scores of the second) of each; -inf for a run that failed. Not empty.

    Returns:
        The mean over tasks; with its interval, where each task has two runs of either method: Student's, of the
        variance of each run's share of the other's runs (Brunner and Munzel 2000).
    """
    total, variances, freedom = 0.0, [], []
    for first, second in tasks:
        x, y = np.asarray(first)[:, None], np.asarray(second)[None]
        better = (x > y) + 0.5 * (x == y)
        total += float(better.mean()) / len(tasks)
        for shares in (better.mean(axis=1), better.mean(axis=0)):
            variances.append(shares.var(ddof=1) / len(shares) / len(tasks) ** 2 if len(shares) > 1 else np.nan)
            freedom.append(len(shares) - 1)
    if not all(freedom):
        return total, None
    return total, interval_around(total, np.array(variances), np.array(freedom)).within(0.0, 1.0)


def improvement_tasks(stability: Stability, method: str) -> list[tuple[list[float], list[float]]]:
    """The PSNR of the method and of the baseline, perturbed alike, in each task that has both."""
    tasks = []
    for case in stability.cases:
        baseline = stability.baseline(case)
        if baseline is not None and baseline != method:
            for severity in stability.severities(case):
                cells = [stability.cell(case, severity, name) for name in (method, baseline)]
                own, theirs = ([value(t.run, "psnr") for t in cell.tried] for cell in cells)
                if own and theirs:
                    tasks.append(([_or_worst(v) for v in own], [_or_worst(v) for v in theirs]))
    return tasks


def _or_worst(psnr: float | None) -> float:
    return -math.inf if psnr is None else psnr
