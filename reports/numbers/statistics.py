"""Statistics: how far a mean over views and seeds can be trusted, and whether it can be told from another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import bootstrap, t

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
    arrays = _checked(strata)
    if arrays is None:
        return None
    found = bootstrap(
        arrays, _mean_of_means, confidence_level=coverage, n_resamples=draws, method="percentile", rng=seed
    )
    low, high = found.confidence_interval
    return Interval(float(low), float(high))


def t_interval(strata: Sequence[ArrayLike], *, coverage: float = COVERAGE) -> Interval | None:
    """Student's interval of the unweighted mean of the strata's means (Student 1908), for a few values that are normal.

    Of several strata the variances of their means are added, with the degrees of freedom of Satterthwaite (1946) and
    Welch (1947). Unlike a bootstrap's it is as wide as so few values ask for: of three it reaches beyond all of them.

    Args and Returns: as `bootstrap_interval`, which see; values that are all alike give an interval without width.

    Raises:
        ValueError: a value is not finite.
    """
    arrays = _checked(strata)
    if arrays is None:
        return None
    mean = float(np.mean([values.mean() for values in arrays]))
    variances = np.array([values.var(ddof=1) / len(values) for values in arrays])
    if not variances.any():
        return Interval(mean, mean)
    shares = variances / variances.sum()  # whose squares, unlike those of tiny variances, are not all 0
    freedom = 1 / sum(share**2 / (len(values) - 1) for share, values in zip(shares, arrays, strict=True))
    half = float(t.ppf((1 + coverage) / 2, freedom) * np.sqrt(variances.sum()) / len(arrays))
    return Interval(mean - half, mean + half)


def _checked(strata: Sequence[ArrayLike]) -> list[NDArray] | None:
    """The strata as arrays, None where there are none or one has fewer than two values."""
    arrays = [np.asarray(values, dtype=np.float64) for values in strata]
    if not arrays or min(map(len, arrays)) < 2:
        return None
    if not all(np.isfinite(values).all() for values in arrays):
        raise ValueError("a value is not finite: leave failed runs out, and count them")
    return arrays


def _mean_of_means(*strata: NDArray, axis: int = -1) -> NDArray:
    return np.sum([values.mean(axis=axis) / len(strata) for values in strata], axis=0)
