"""Statistics: how far a mean over views and seeds can be trusted, and whether it can be told from another."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

COVERAGE = 0.95
DRAWS = 2000
FEWEST_SEEDS = 3  # for a verdict: a bootstrap over two seeds knows no more than the two values


class Interval(NamedTuple):
    """A confidence interval of a mean."""

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
        coverage: share of the two-sided interval.
        draws: resamples.
        seed: the generator's; the same values give the same interval, always.

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
    means = np.zeros(draws)
    for values, picks in zip(arrays, _picks(tuple(map(len, arrays)), draws, seed), strict=True):
        means += values[picks].mean(axis=1) / len(arrays)
    tail = (1 - coverage) / 2
    low, high = np.quantile(means, [tail, 1 - tail])
    return Interval(float(low), float(high))


@lru_cache(maxsize=32)
def _picks(sizes: tuple[int, ...], draws: int, seed: int) -> list[np.ndarray]:
    """Indices into strata of these sizes, [draws, size] each: the same for all numbers of one table."""
    generator = np.random.default_rng(seed)
    return [generator.integers(size, size=(draws, size)) for size in sizes]
