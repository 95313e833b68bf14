"""Estimates: the mean over seeds and data sets of one number of one method, and how far it can be trusted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property

import numpy as np
import pandas as pd

from .decimals import mean
from .intervals import Interval, mean_interval

Key = tuple[str, str, str, str]  # dataset, method, region, metric


@dataclass(frozen=True)
class Estimate:
    """The mean over seeds of one data set, or of the means of several, in the stored unit."""

    strata: tuple[tuple[float, ...], ...] = ()  # the values over seeds, one tuple a data set that has any
    done: int = 0
    expected: int = 0  # `done` counts runs within one data set, data sets in a mean over several
    averaged: bool = False  # over data sets
    not_computed: bool = False

    @cached_property
    def mean(self) -> Decimal | None:
        """Unrounded; None where there are no values."""
        return mean(mean(values) for values in self.strata) if self.strata else None

    @cached_property
    def spread(self) -> float | None:
        """Sample standard deviation over seeds; None for one seed or several data sets."""
        if self.averaged or not self.strata or len(self.strata[0]) < 2:
            return None
        return float(np.std(self.strata[0], ddof=1))

    @cached_property
    def interval(self) -> Interval | None:
        return mean_interval(self.strata)

    @property
    def complete(self) -> bool:
        return self.mean is not None and self.done == self.expected


class Numbers:
    """The tidy table and the attempts behind it, ready for look-up."""

    def __init__(self, tidy: pd.DataFrame, attempts: pd.DataFrame):
        """`tidy` has dataset, method, seed, region, metric, value; `attempts` dataset, method, seed, status."""
        self._values: dict[Key, dict[int, float]] = {}  # by seed
        self._known: set[Key] = set()
        columns = (tidy[name].tolist() for name in ("dataset", "method", "region", "metric", "seed", "value"))
        for dataset, method, region, metric, seed, value in zip(*columns, strict=True):
            key = (dataset, method, region, metric)
            self._known.add(key)
            if value == value:  # not NaN
                self._values.setdefault(key, {})[seed] = value
        self._statuses: dict[tuple[str, str], Counter[str]] = {}
        for dataset, method, status in attempts[["dataset", "method", "status"]].itertuples(index=False):
            self._statuses.setdefault((dataset, method), Counter())[status] += 1
        self._regions: dict[str, set[str]] = {}
        for dataset, _, region, _ in self._known:
            if region != "full":
                self._regions.setdefault(dataset, set()).add(region)
        self._found: dict[tuple[tuple[str, ...], str, str, str, str], Estimate] = {}

    def statuses(self, datasets: Sequence[str], method: str) -> Counter[str]:
        """How many runs of the method on the data sets ended how."""
        return sum((self._statuses.get((dataset, method), Counter()) for dataset in datasets), Counter[str]())

    def regions(self, datasets: Sequence[str]) -> list[str]:
        """The masked regions that any of the data sets has, by name."""
        return sorted(set().union(*(self._regions.get(dataset, set()) for dataset in datasets)))

    def having(self, datasets: Sequence[str], region: str) -> tuple[str, ...]:
        """The data sets that have the region."""
        return tuple(name for name in datasets if region == "full" or region in self._regions.get(name, set()))

    def estimate(self, datasets: tuple[str, ...], method: str, region: str, metric: str, against: str = "") -> Estimate:
        """For one data set, or the unweighted mean over several: complete only where every run of each finished.

        Args:
            against: a method whose value of the same seed is subtracted from each; "" for none.
        """
        key = (datasets, method, region, metric, against)
        if key not in self._found:
            self._found[key] = self._estimate(*key)
        return self._found[key]

    def _estimate(self, datasets: tuple[str, ...], method: str, region: str, metric: str, against: str) -> Estimate:
        if len(datasets) == 1:
            place = (datasets[0], method, region, metric)
            values = self._values.get(place, {})
            if against:
                theirs = self._values.get((datasets[0], against, region, metric), {})
                values = {seed: value - theirs[seed] for seed, value in values.items() if seed in theirs}
            return Estimate(
                strata=(tuple(values[seed] for seed in sorted(values)),) if values else (),
                done=len(values),
                expected=self.statuses(datasets, method).total(),
                not_computed=place in self._known and not values and not against,
            )
        parts = [self.estimate((dataset,), method, region, metric, against) for dataset in datasets]
        return Estimate(
            strata=tuple(values for part in parts for values in part.strata),
            done=sum(part.complete for part in parts),
            expected=len(parts),
            averaged=True,
            not_computed=any(part.not_computed for part in parts),
        )
