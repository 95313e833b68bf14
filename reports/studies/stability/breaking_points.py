"""Breaking points: the severity at which a method has lost its gain over a baseline, or a share of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...numbers.intervals import COVERAGE, Interval
from .perturbed_runs import value
from .stability import Case, Stability

DRAWS = 2000  # of the seeds: where a curve meets a level is no mean, so Student's interval is not for it
SHARES = (0.5, 0.0)  # of the unperturbed gain that is left: half of it, and none


@dataclass(frozen=True)
class BreakingPoint:
    """Where the gain falls to a share of what it is unperturbed, in severities, which are interpolated between.

    Attributes:
        severity: infinite where it did not within the severities that were tried.
        interval: over seeds; an end is infinite likewise; None for one seed.
        seeds: with an unperturbed gain.
    """

    share: float
    severity: float
    interval: Interval | None
    seeds: int


def breaking_points(stability: Stability, case: Case, method: str) -> list[BreakingPoint]:
    """Of the method against the case's baseline, over the full image; none where there is no gain to lose."""
    baseline = stability.baseline(case)
    if baseline is None or baseline == method:
        return []
    severities = [0, *stability.severities(case)]
    runs = [(stability.runs(case, s, method), stability.runs(case, s, baseline)) for s in severities]
    rows = []
    for seed in runs[0][0]:
        row = []
        for own, theirs in runs:
            rival = value(theirs[seed], "psnr") if seed in theirs else None
            if seed not in own or rival is None:
                row.append(math.nan)
            else:
                psnr = value(own[seed], "psnr")
                row.append(-math.inf if psnr is None else psnr - rival)
        rows.append(row)
    gains = np.array([row for row in rows if math.isfinite(row[0])])
    if not len(gains) or gains[:, 0].mean() <= 0:
        return []
    return [breaking_point(severities, gains, share) for share in SHARES]


def breaking_point(severities: Sequence[float], gains: np.ndarray, share: float, seed: int = 0) -> BreakingPoint:
    """Where the mean gain first falls to `share` of that at the first severity.

    Args:
        severities: [S], increasing; the first is 0, unperturbed.
        gains: [seeds, S] dB over the baseline; -inf where the method's run failed, NaN where there is no pair. A
            severity at which more than half of the seeds failed has lost any gain; else the mean is over the others.
        share: of the unperturbed gain, in [0, 1].
        seed: of the bootstrap over seeds, each with all of its severities.
    """
    whole = np.arange(len(gains))[None]
    point = float(_first_below(severities, gains[whole], share)[0])
    interval = None
    if len(gains) > 1:
        picks = np.random.default_rng(seed).integers(len(gains), size=(DRAWS, len(gains)))
        found = np.sort(_first_below(severities, gains[picks], share))
        tail = int(DRAWS * (1 - COVERAGE) / 2)
        interval = Interval(float(found[tail]), float(found[-1 - tail]))
    return BreakingPoint(share, point, interval, len(gains))


def _first_below(severities: Sequence[float], gains: np.ndarray, share: float) -> np.ndarray:
    """[draws] of gains [draws, seeds, S]."""
    failed, known = np.isneginf(gains).sum(axis=1), np.isfinite(gains).sum(axis=1)
    sums = np.where(np.isfinite(gains), gains, 0).sum(axis=1)
    means = np.where(known > 0, sums / np.maximum(known, 1), np.nan)
    means = np.where(failed > known, -np.inf, means)
    target = share * means[:, 0]
    found = np.where(means[:, 0] <= 0, 0.0, np.inf)
    before, at = means[:, 0], np.full(len(means), float(severities[0]))
    for index in range(1, len(severities)):
        mean = means[:, index]
        reached = np.isinf(found) & (mean <= target)
        with np.errstate(invalid="ignore", divide="ignore"):
            way = np.where(np.isneginf(mean), 1.0, (before - target) / (before - mean))
        found = np.where(reached, at + way * (severities[index] - at), found)
        tried = ~np.isnan(mean)  # a severity without a pair tells nothing: the next one goes on from the one before it
        before, at = np.where(tried, mean, before), np.where(tried, float(severities[index]), at)
    return found
