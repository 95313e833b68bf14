"""Profiles over all perturbations: how many runs lose how much, and how likely a method beats another.

After Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice": performance profiles
and the probability of improvement, over tasks (here a data set, kind and severity) with few seeds each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .estimates import Estimate
from .stability import Stability
from .statistics import COVERAGE, DRAWS, Interval
from .trials import value

DROPS = tuple(0.25 * step for step in range(41))  # dB, at which profiles are taken


def drops(stability: Stability, method: str) -> list[list[float]]:
    """A list a task: the drop in PSNR of each of the method's trials, infinite where it did not finish."""
    found = []
    for case in stability.cases:
        for severity in stability.severities(case):
            trials = [t for t in stability.cell(case, severity, method).tried if t.paired]
            lost = [math.inf if not t.run.ok else t.drop("psnr") for t in trials]
            if known := [drop for drop in lost if drop is not None]:
                found.append(known)
    return found


def profile(tasks: Sequence[Sequence[float]], most: float) -> Estimate:
    """The share of runs that lose at most so many dB, every task counting alike."""
    shares = tuple(tuple(float(drop <= most) for drop in task) for task in tasks)
    return Estimate(strata=shares, done=len(shares), expected=len(shares), averaged=True)


def survival(stability: Stability, method: str, severity: int) -> Estimate:
    """The share of runs that survive their gates at a severity, every data set and kind counting alike."""
    cells = [stability.cell(case, severity, method) for case in stability.cases]
    shares = tuple(tuple(float(not trial.failed) for trial in cell.tried) for cell in cells if cell.tried)
    return Estimate(strata=shares, done=len(shares), expected=len(shares), averaged=True)


def probability_of_improvement(
    tasks: Sequence[tuple[Sequence[float], Sequence[float]]], seed: int = 0
) -> tuple[float, Interval | None]:
    """That a run of the first method scores higher than one of the second, a draw counting as half.

    Args:
        tasks: (scores of the first, scores of the second) of each; -inf for a run that failed. Not empty.
        seed: of the bootstrap, which resamples the runs of either method within each task.

    Returns:
        The mean over tasks; with its interval, where each task has two runs of either method.
    """
    rng = np.random.default_rng(seed)
    total, means = 0.0, np.zeros(DRAWS)
    enough = True
    for first, second in tasks:
        x, y = np.asarray(first)[:, None], np.asarray(second)[None]
        better = (x > y) + 0.5 * (x == y)
        total += better.mean() / len(tasks)
        enough &= min(better.shape) > 1
        i, j = (rng.integers(size, size=(DRAWS, size)) for size in better.shape)
        means += better[i[:, :, None], j[:, None, :]].mean(axis=(1, 2)) / len(tasks)
    tail = (1 - COVERAGE) / 2
    low, high = np.quantile(means, [tail, 1 - tail])
    return float(total), Interval(float(low), float(high)) if enough else None


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
