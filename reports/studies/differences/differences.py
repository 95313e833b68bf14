"""Differences to the best: how far the method that is best on most data sets is ahead of every other, seed by seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ...numbers.comparison import Comparison, compare
from ...numbers.estimates import Numbers


@dataclass(frozen=True)
class Differences:
    """One method against all others.

    Attributes:
        best: the method with the best mean PSNR on the most data sets.
        others: every other method that was tried on these data sets, in the tables' order.
        datasets: on which all of its own runs finished.
    """

    numbers: Numbers
    best: str
    others: tuple[str, ...]
    datasets: tuple[str, ...]

    def to(self, other: str, datasets: tuple[str, ...], region: str, metric: str) -> Comparison:
        """The best method against the other: on one data set, or as the unweighted mean over several."""
        return compare(self.numbers, datasets, self.best, other, metric, region)


def differences(numbers: Numbers, datasets: Sequence[str], methods: Sequence[str]) -> Differences | None:
    """Those of the best of the methods to the others; None where nobody can be compared over two seeds and more.

    Of methods that are best equally often, it is the one with the higher mean over the data sets that all of them
    finished, then the first.
    """
    means = {(d, m): value for d in datasets for m in methods if (value := _psnr(numbers, d, m)) is not None}
    contested = [d for d in datasets if sum(bool(numbers.statuses((d,), m)) for m in methods) > 1]
    winners = [_best({m: means[d, m] for m in methods if (d, m) in means}) for d in contested]
    wins = {m: winners.count(m) for m in methods}
    tied = [m for m in methods if wins[m] and wins[m] == max(wins.values())]
    shared = [d for d in contested if all((d, m) in means for m in tied)]
    best = max(tied, key=lambda m: sum(means[d, m] for d in shared), default="")
    own = tuple(d for d in contested if (d, best) in means)
    others = tuple(m for m in methods if m != best and numbers.statuses(own, m))
    found = Differences(numbers, best, others, own)
    pairs = (found.to(other, (d,), "full", "psnr") for other in others for d in own)
    return found if any(pair.gain is not None for pair in pairs) else None


def _best(means: Mapping[str, float]) -> str:
    """The method with the highest mean, "" where there is none."""
    return max(means, key=lambda method: means[method], default="")


def _psnr(numbers: Numbers, dataset: str, method: str) -> float | None:
    """The mean over seeds, where all of its runs finished."""
    estimate = numbers.estimate((dataset,), method, "full", "psnr")
    return float(estimate.mean) if estimate.complete and estimate.mean is not None else None
