"""Statistics: how far a mean over views and seeds can be trusted, and which results it cannot tell apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

COVERAGE = 0.95
DRAWS = 2000


@dataclass(frozen=True)
class Interval:
    """A mean and its confidence interval."""

    mean: float
    low: float
    high: float

    def overlaps(self, other: Interval) -> bool:
        """Whether the two intervals share a point."""
        return self.low <= other.high and other.low <= self.high


def bootstrap_interval(
    strata: Sequence[ArrayLike], *, coverage: float = COVERAGE, draws: int = DRAWS, seed: int = 0
) -> Interval | None:
    """Stratified percentile bootstrap of the unweighted mean of the strata's means (Efron and Tibshirani 1993).

    Values are resampled within their stratum only, so that scenes, which differ by far more than views or seeds do,
    add nothing to the spread: the interval is for these scenes, not for scenes at large.

    Args:
        strata: one sequence a scene: its values by view, or by seed. Every stratum counts alike, whatever its length.
        coverage: of the two-sided interval.
        draws: resamples.
        seed: of the generator; the same values give the same interval, always.

    Returns:
        None where there are no strata or one has fewer than two values: a single value says nothing of its spread.

    Raises:
        ValueError: a value is not finite.
    """
    arrays = [np.asarray(values, dtype=np.float64) for values in strata]
    if not arrays or min(map(len, arrays)) < 2:
        return None
    if not all(np.isfinite(values).all() for values in arrays):
        raise ValueError("a value is not finite: leave failed runs out, and count them")
    generator = np.random.default_rng(seed)
    means = np.zeros(draws)
    for values in arrays:
        picks = generator.integers(len(values), size=(draws, len(values)))
        means += values[picks].mean(axis=1) / len(arrays)
    tail = (1 - coverage) / 2
    low, high = np.quantile(means, [tail, 1 - tail])
    return Interval(float(np.mean([values.mean() for values in arrays])), float(low), float(high))


def tied_with_best(intervals: Mapping[str, Interval], *, higher_is_better: bool) -> set[str]:
    """Names of the results that the best mean cannot be told apart from: their intervals overlap its own.

    The best is among them. Conservative: intervals of 95 % each may overlap where a paired test would tell the two
    apart, so what is left out is worse, and what is kept may be.
    """
    if not intervals:
        return set()
    choose = max if higher_is_better else min
    best = intervals[choose(intervals, key=lambda name: intervals[name].mean)]
    return {name for name, interval in intervals.items() if interval.overlaps(best)}
