"""Lead: how far the method that is best on most data sets is ahead of every other one, seed by seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from .estimates import Estimate, Numbers
from .statistics import Interval, t_interval


class Difference(Estimate):
    """The mean of differences that are paired by seed, with Student's interval: a bootstrap of so few is too narrow."""

    @cached_property
    def interval(self) -> Interval | None:
        return t_interval(self.strata)


@dataclass(frozen=True)
class Lead:
    """One method against all others.

    Attributes:
        leader: the method with the best mean PSNR on the most data sets.
        others: every other method that was tried on these data sets, in the tables' order.
        datasets: on which all of its own runs finished.
    """

    numbers: Numbers
    leader: str
    others: tuple[str, ...]
    datasets: tuple[str, ...]

    def over(self, other: str, datasets: tuple[str, ...], region: str, metric: str) -> Difference:
        """The leader's value minus the other's: on one data set, or the unweighted mean over several."""
        found = self.numbers.estimate(datasets, self.leader, region, metric, other)
        return Difference(found.strata, found.done, found.expected, found.averaged, found.not_computed)


def lead(numbers: Numbers, datasets: Sequence[str], methods: Sequence[str]) -> Lead | None:
    """The lead among the methods; None where nobody can be compared over two seeds and more.

    Of methods that are best equally often, the one with the higher mean over the data sets that all of them finished
    leads, then the first.
    """
    means = {(d, m): value for d in datasets for m in methods if (value := _psnr(numbers, d, m)) is not None}
    contested = [d for d in datasets if sum(bool(numbers.statuses((d,), m)) for m in methods) > 1]
    best = [_best({m: means[d, m] for m in methods if (d, m) in means}) for d in contested]
    wins = {m: best.count(m) for m in methods}
    tied = [m for m in methods if wins[m] and wins[m] == max(wins.values())]
    shared = [d for d in contested if all((d, m) in means for m in tied)]
    leader = max(tied, key=lambda m: sum(means[d, m] for d in shared), default="")
    own = tuple(d for d in contested if (d, leader) in means)
    others = tuple(m for m in methods if m != leader and numbers.statuses(own, m))
    found = Lead(numbers, leader, others, own)
    pairs = (found.over(other, (d,), "full", "psnr") for other in others for d in own)
    return found if any(pair.interval is not None for pair in pairs) else None


def _best(means: Mapping[str, float]) -> str:
    """The method with the highest mean, "" where there is none."""
    return max(means, key=lambda method: means[method], default="")


def _psnr(numbers: Numbers, dataset: str, method: str) -> float | None:
    """The mean over seeds, where all of its runs finished."""
    estimate = numbers.estimate((dataset,), method, "full", "psnr")
    return float(estimate.mean) if estimate.complete and estimate.mean is not None else None
