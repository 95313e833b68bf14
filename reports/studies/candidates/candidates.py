"""Candidates for a method's settings beside the method as it is, judged by the tuning protocol's rules."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from ...numbers.comparison import Comparison, compare
from ...numbers.estimates import Estimate, Numbers
from ...numbers.labels import Label, is_set_up, method_order
from ...numbers.runs import Run

LEAST_GAIN = 0.1  # dB of PSNR as a mean over the data sets: what is less may be chance
FEWEST_RUNS = 2  # of a candidate and of the method on each data set
KNOWN = "covisible"  # the region of what some training view shows
UNKNOWN = "what no training view shows"

Verdict = Literal["keep", "loses", "no gain", "not shown", "incomplete"]
Views = Mapping[tuple[str, str], Mapping[int, Mapping[str, float]]]  # PSNR by (data set, row), seed and view


@dataclass(frozen=True)
class DecidingPart:
    """A part of a data set's pictures on which it hangs whether a candidate gains or loses there, dB."""

    dataset: str
    part: str  # one view, or UNKNOWN
    gain: float  # of all
    without: float  # of all else


@dataclass(frozen=True)
class Candidates:
    """Rows of one method and as many steps that differ in its settings; every difference is paired by seed.

    Attributes:
        base: the row of the method as it is.
        rows: the candidates, in the tables' order.
        datasets: on which the method as it is was tried.
    """

    numbers: Numbers
    name: str
    base: str
    rows: tuple[str, ...]
    datasets: tuple[str, ...]
    views: Views

    def comparison(self, row: str, *datasets: str, region: str = "full") -> Comparison:
        """PSNR of the row against the method's as it is, dB: on one data set, or the unweighted mean over several."""
        return compare(self.numbers, datasets, row, self.base, "psnr", region)

    def difference(self, row: str, *datasets: str, region: str = "full") -> Estimate:
        return self.comparison(row, *datasets, region=region).difference

    def gain(self, row: str, *datasets: str) -> float:
        """The mean of `difference`: 0 of the method as it is, and where nothing can be compared."""
        return float(self.difference(row, *datasets).mean or 0)

    @cached_property
    def spreads(self) -> dict[str, float]:
        """The standard deviation of a run over its seeds on each data set, dB, pooled over all rows of two and more."""
        found = {}
        for dataset in self.datasets:
            rows = [self.numbers.estimate((dataset,), row, "full", "psnr") for row in (self.base, *self.rows)]
            several = [(row.spread, row.done - 1) for row in rows if row.spread is not None]
            if several:
                squares = sum(spread**2 * degrees for spread, degrees in several)
                found[dataset] = math.sqrt(squares / sum(degrees for _, degrees in several))
        return found

    def lacking(self, candidate: str) -> list[str]:
        """The data sets on which not all of its runs and the method's finished, or too few to be compared."""
        return [dataset for dataset in self.datasets if not self._compared(candidate, dataset)]

    def _compared(self, candidate: str, dataset: str) -> bool:
        rows = (self.base, candidate)
        finished = all(self.numbers.estimate((dataset,), row, "full", "psnr").complete for row in rows)
        return finished and self.difference(candidate, dataset).done >= FEWEST_RUNS

    def losses(self, candidate: str) -> dict[str, float]:
        """The data sets on which its mean lacks more than a run varies by its seed, and how much, dB, negative."""
        differences = {dataset: self.difference(candidate, dataset).mean for dataset in self.datasets}
        known = {name: float(mean) for name, mean in differences.items() if mean is not None and name in self.spreads}
        return {name: mean for name, mean in known.items() if mean < -self.spreads[name]}

    def verdict(self, candidate: str) -> Verdict:
        """By the rules: it is shown to be better as the mean over the data sets, gains LEAST_GAIN there, and on none of
        them lacks more than a run varies by its seed."""
        if self.lacking(candidate):
            return "incomplete"
        if self.losses(candidate):
            return "loses"
        if self.gain(candidate, *self.datasets) < LEAST_GAIN:
            return "no gain"
        return "keep" if self.comparison(candidate, *self.datasets).better() else "not shown"

    @cached_property
    def comparable(self) -> tuple[str, ...]:
        """The method as it is, and the candidates that lack nothing."""
        return (self.base, *(candidate for candidate in self.rows if not self.lacking(candidate)))

    def chosen_without(self, dataset: str) -> str:
        """The row that all other data sets would choose by their mean alone."""
        others = [name for name in self.datasets if name != dataset]
        return max(self.comparable, key=lambda row: self.gain(row, *others))

    def deciding_parts(self, candidate: str) -> list[DecidingPart]:
        """Of each data set the view that moves its difference most, and what no training view shows.

        Where without it a gain is a loss or the reverse, or a loss becomes one that counts; what moves by less than a
        run varies by its seed is left out.
        """
        found = []
        for dataset in self.spreads:
            parts = (self._most_moving_view(candidate, dataset), self._unknown(candidate, dataset))
            found += [part for part in parts if part is not None and self._decides(part)]
        return found

    def _decides(self, part: DecidingPart) -> bool:
        spread = self.spreads[part.dataset]
        turns = any((part.gain < limit) != (part.without < limit) for limit in (0, -spread))
        return turns and abs(part.without - part.gain) > spread

    def _most_moving_view(self, candidate: str, dataset: str) -> DecidingPart | None:
        own, theirs = (self.views.get((dataset, row), {}) for row in (candidate, self.base))
        paired = [(own[seed], theirs[seed]) for seed in own if seed in theirs]
        shared = sorted(set[str].intersection(*(set(a) & set(b) for a, b in paired))) if paired else []
        if len(shared) < 2:
            return None
        gains = np.array([[a[view] - b[view] for view in shared] for a, b in paired]).mean(axis=0)
        whole = float(gains.mean())
        without = (gains.sum() - gains) / (len(gains) - 1)
        most = int(np.abs(without - whole).argmax())
        return DecidingPart(dataset, f"view {shared[most]}", whole, float(without[most]))

    def _unknown(self, candidate: str, dataset: str) -> DecidingPart | None:
        whole, known = self.difference(candidate, dataset).mean, self.difference(candidate, dataset, region=KNOWN).mean
        return None if whole is None or known is None else DecidingPart(dataset, UNKNOWN, float(whole), float(known))


def candidates_of(numbers: Numbers, runs: Iterable[tuple[str, Label, Run]]) -> list[Candidates]:
    """What there is to choose from among (data set's label, method's label, run): by method, then by steps.

    The method as it is has runs that no override set up: of several such rows that with the most runs. Where there is
    none, nothing can be held against it.
    """
    groups: dict[tuple[str, int], list[tuple[str, Label, Run]]] = {}
    for dataset, label, run in runs:
        groups.setdefault((label.name, run.record.steps), []).append((dataset, label, run))
    found = [_candidates(numbers, name, group) for (name, _), group in sorted(groups.items(), key=lambda item: item[0])]
    return [candidates for candidates in found if candidates is not None]


def _candidates(numbers: Numbers, name: str, runs: list[tuple[str, Label, Run]]) -> Candidates | None:
    labels = {str(label): label for _, label, _ in runs}
    plain = [str(label) for _, label, run in runs if not is_set_up(run)]
    if len(labels) < 2 or not plain:
        return None
    base = max(dict.fromkeys(plain), key=plain.count)
    others = sorted((row for row in labels if row != base), key=lambda row: method_order(labels[row]))
    views: dict[tuple[str, str], dict[int, Mapping[str, float]]] = {}
    for dataset, label, run in runs:
        if run.ok:
            views.setdefault((dataset, str(label)), {})[run.record.seed] = run.of_views("psnr")
    datasets = sorted({dataset for dataset, label, _ in runs if str(label) == base})
    return Candidates(numbers, name, base, tuple(others), tuple(datasets), views)
