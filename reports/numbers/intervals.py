"""Intervals: how far a mean over seeds and data sets can be trusted: Student's; over many scenes, by resampling."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaincinv, stdtrit  # of scipy.stats, which takes a second to import, some quantiles

COVERAGE = 0.95
RESAMPLES = 4000


class Interval(NamedTuple):
    """A confidence interval of a mean."""

    low: float
    high: float

    def within(self, low: float, high: float) -> Interval:
        """Cut off at the ends of what is possible, as 0 and 1 of a share."""
        return Interval(max(self.low, low), min(self.high, high))


def mean_interval(strata: Sequence[ArrayLike], coverage: float = COVERAGE) -> Interval | None:
    """Student's interval of the unweighted mean of the strata's means (Student 1908).

    Of several strata the variances of their means are added, with the degrees of freedom of Satterthwaite (1946) and
    Welch (1947). Scenes differ by far more than seeds do, and add nothing: the interval is for these scenes, not for
    scenes at large. A percentile bootstrap of three seeds, which never reaches beyond the three, holds the mean in 75
    to 85 of 100 cases where it says 95; this one holds it in 95 to 97.

    Args:
        strata: one sequence a data set, its values by seed. Every stratum counts alike, whatever its length.
        coverage: share of the two-sided interval.

    Returns:
        None where there are no strata or one has fewer than two values: a single value says nothing of its spread.
        Values that are all alike give an interval without width.

    Raises:
        ValueError: a value is not finite.
    """
    arrays = [np.asarray(values, dtype=np.float64) for values in strata]
    if not arrays or min(map(len, arrays)) < 2:
        return None
    if not all(np.isfinite(values).all() for values in arrays):
        raise ValueError("a value is not finite: leave failed runs out, and count them")
    mean = float(np.mean([values.mean() for values in arrays]))
    variances = np.array([values.var(ddof=1) / len(values) for values in arrays]) / len(arrays) ** 2
    return interval_around(mean, variances, np.array([len(values) - 1 for values in arrays]), coverage)


def interval_around(mean: float, variances: np.ndarray, freedom: np.ndarray, coverage: float = COVERAGE) -> Interval:
    """Student's interval of a sum of independent means.

    Args:
        mean: the sum.
        variances: [N] of the N means.
        freedom: [N] degrees of freedom of each variance.
    """
    if not variances.any():
        return Interval(mean, mean)
    shares = variances / variances.sum()  # whose squares, unlike those of tiny variances, are not all 0
    degrees = 1 / (shares**2 / freedom).sum()
    half = float(stdtrit(degrees, (1 + coverage) / 2) * np.sqrt(variances.sum()))
    return Interval(mean - half, mean + half)


def sample_interval(values: ArrayLike, less: ArrayLike | None = None, coverage: float = COVERAGE) -> Interval | None:
    """The percentile bootstrap's interval of the mean of many values, or of its difference to another sample's mean.

    For values drawn from a population, as scenes of a distribution are, a dozen or more; few are `mean_interval`'s.
    Differences of methods on the same scenes are one sample. The same values give the same interval.

    Returns:
        None where there are fewer than two values.
    """
    samples = [np.asarray(one, dtype=np.float64) for one in ((values,) if less is None else (values, less))]
    if min(map(len, samples)) < 2:
        return None
    random = np.random.default_rng(0)
    means = [one[random.integers(len(one), size=(RESAMPLES, len(one)))].mean(axis=1) for one in samples]
    found = means[0] if less is None else means[0] - means[1]
    tail = (1 - coverage) / 2
    return Interval(*(float(end) for end in np.quantile(found, (tail, 1 - tail))))


def share_interval(hits: int, count: int, coverage: float = COVERAGE) -> Interval:
    """Clopper and Pearson's interval (1934) of a share of which `hits` of `count` were seen."""
    tail = (1 - coverage) / 2
    low = float(betaincinv(hits, count - hits + 1, tail)) if hits else 0.0
    high = float(betaincinv(hits + 1, count - hits, 1 - tail)) if hits < count else 1.0
    return Interval(low, high)
