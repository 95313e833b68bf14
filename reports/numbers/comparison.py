"""Comparison: whether one method is better than another. Every part of a report that says so says it by this."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from .estimates import Estimate, Numbers
from .intervals import Interval

FEWEST_SEEDS = 3  # in common on a data set, for a verdict on it


@dataclass(frozen=True)
class Comparison:
    """One method against another on the same data sets, paired by data set and seed.

    Runs of one seed see the same views in the same order, and data sets differ by decibels: pairs take both out of the
    difference. Its interval is Student's over seeds, with Welch's degrees of freedom over data sets (`mean_interval`).
    That was chosen from what reports had (percentile bootstraps, paired or not, and Student's): of three seeds it alone
    holds the mean as often as it says.

    The rule: a method is better where the whole interval is beyond 0, or beyond a tolerance. It is as good where the
    whole interval stays above minus the tolerance. Both are tied where neither is shown.

    Attributes:
        difference: the method's value minus the other's, in the stored unit.
        sign: 1 where more is better, -1 where less is.
    """

    difference: Estimate
    sign: int = 1

    @cached_property
    def gain(self) -> Interval | None:
        """The interval of the difference, positive where the method is better; None where it has none."""
        interval = self.difference.interval
        return None if interval is None else Interval(*sorted(self.sign * end for end in interval))

    @property
    def decided(self) -> bool:
        """Whether there are seeds enough for a verdict: FEWEST_SEEDS on one data set, pairs on each of several."""
        return self.gain is not None and (self.difference.averaged or self.difference.done >= FEWEST_SEEDS)

    def better(self, by: float = 0.0) -> bool:
        """Whether the method is shown to be better than the other by more than `by`."""
        return self.decided and self.gain is not None and self.gain.low > by

    def worse(self, by: float = 0.0) -> bool:
        """Whether the method is shown to be worse than the other by more than `by`."""
        return self.decided and self.gain is not None and self.gain.high < -by

    def as_good(self, within: float) -> bool:
        """Whether the method is shown to lose no more than `within`."""
        return self.decided and self.gain is not None and self.gain.low >= -within

    @property
    def tied(self) -> bool:
        """Whether seeds in common leave open which of both is better."""
        return self.gain is not None and self.gain.low <= 0 <= self.gain.high


def compare(
    numbers: Numbers,
    datasets: tuple[str, ...],
    method: str,
    other: str,
    metric: str,
    region: str = "full",
    sign: int = 1,
) -> Comparison:
    """The method against the other on one data set, or as the unweighted mean over several."""
    return Comparison(numbers.estimate(datasets, method, region, metric, other), sign)
