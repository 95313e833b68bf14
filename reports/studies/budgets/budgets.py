"""Budgets: what a model is worth at each size, where its curve bends, and base against environment."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from envgs_bench.parts import BASE, ENV

from ...numbers.comparison import FEWEST_SEEDS, Comparison
from ...numbers.estimates import Estimate, Numbers
from ...numbers.labels import Label
from ...numbers.settings import LIMITS, as_number
from .bd_rate import bd_rate

PRUNED = "settings.prune_error"  # what prunings may cost, as labels have it: the more, the smaller is the model
KEYS = (*(f"budget.{limit}" for limit in LIMITS), PRUNED)
MAP_KEYS = ("settings.max_primitives", "settings.env_max_primitives")  # of base and environment, as labels have them
TIED_DB = 0.1  # a budget is as good as the best if it surely loses no more


@dataclass(frozen=True)
class Quantity:
    """A number that is drawn against the primitives."""

    metric: str
    region: str = "full"

    @property
    def name(self) -> str:
        return self.metric if self.region == "full" else f"{self.metric}_{self.region}"


PSNR = Quantity("psnr")
QUANTITIES = (PSNR, Quantity("psnr", "reflective"), Quantity("psnr", "near_field"), Quantity("lpips"))
COSTS = (
    *(Quantity(name) for name in ("primitives", f"primitives_{BASE}", f"primitives_{ENV}")),
    *(Quantity(name) for name in ("peak_primitives", "model_bytes", "frame_ms", "train_seconds")),
)


@dataclass(frozen=True)
class BudgetRow:
    """One method within one budget, or pruned as far as one error: a row of the section's tables."""

    method: str  # the row's label
    limit: float  # infinite without a budget, and without prunings


@dataclass(frozen=True)
class Knee:
    """Where more primitives stop to pay: the smallest budget that surely loses at most TIED_DB against the best one.

    Attributes:
        row: None where there is no knee; `why` says it then.
        best: the row with the largest mean PSNR.
        loss: of the knee against the best, paired by seed, dB.
    """

    row: BudgetRow | None
    best: BudgetRow | None
    loss: Estimate
    why: str = ""


@dataclass(frozen=True)
class BudgetCurve:
    """One method on one data set within several budgets of one kind, by how large they let a model be."""

    dataset: str
    method: str  # its label without the budget
    key: str  # of KEYS
    rows: tuple[BudgetRow, ...]
    numbers: Numbers

    def estimate(self, row: BudgetRow, quantity: Quantity, against: BudgetRow | None = None) -> Estimate:
        """Over the finished runs, or, paired by seed, minus those of the row `against`."""
        other = against.method if against else ""
        return self.numbers.estimate((self.dataset,), row.method, quantity.region, quantity.metric, other)

    def rate_against(self, anchor: BudgetCurve) -> float | None:
        """The BD-rate of primitives at equal PSNR, of the means over seeds; see `bd_rate`."""
        return bd_rate(self._points(), anchor._points())

    def _points(self) -> list[tuple[float, float]]:
        found = ((self.estimate(row, Quantity("primitives")).mean, self.estimate(row, PSNR).mean) for row in self.rows)
        return [(float(count), float(psnr)) for count, psnr in found if count and psnr is not None]

    @property
    def knee(self) -> Knee:
        means = [(mean, row) for row in self.rows if (mean := self.estimate(row, PSNR).mean) is not None]
        if not means:
            return Knee(None, None, Estimate(), "no run finished")
        best = max(means, key=lambda item: item[0])[1]
        for row in self.rows[: self.rows.index(best)]:
            change = self.estimate(row, PSNR, best)
            if _ties(change):
                return Knee(row, best, change)
        seeds = self.estimate(best, PSNR).done
        if seeds < FEWEST_SEEDS:
            return Knee(None, best, Estimate(), f"{seeds} of at least {FEWEST_SEEDS} seeds")
        if best == self.rows[-1]:
            return Knee(None, best, Estimate(), "still better at the largest budget")
        return Knee(best, best, Estimate())


@dataclass(frozen=True)
class BudgetMap:
    """EnvGS on one data set with so many primitives of the base times so many of the environment."""

    dataset: str
    method: str  # its label without the two size limits
    rows: Mapping[tuple[int, int], str]  # (base, environment) -> the row's label
    numbers: Numbers

    @property
    def base(self) -> list[int]:
        return sorted({base for base, _ in self.rows})

    @property
    def env(self) -> list[int]:
        return sorted({env for _, env in self.rows})

    def estimate(
        self, base: int, env: int, quantity: Quantity = PSNR, against: tuple[int, int] | None = None
    ) -> Estimate:
        """Over the finished runs, or, paired by seed, minus those `against`; empty where that was not tried."""
        row = self.rows.get((base, env))
        if row is None:
            return Estimate()
        other = self.rows[against] if against else ""
        return self.numbers.estimate((self.dataset,), row, quantity.region, quantity.metric, other)

    @property
    def best(self) -> tuple[int, int] | None:
        """The size limits with the largest mean PSNR, of equal ones the smallest; None where no run finished."""
        means = {at: mean for at in sorted(self.rows) if (mean := self.estimate(*at).mean) is not None}
        return max(means, key=lambda at: means[at]) if means else None

    @property
    def knee(self) -> tuple[int, int] | None:
        """The size limits of the smallest sum that surely lose at most TIED_DB against the best; None where none do."""
        best = self.best
        smaller = sorted((at for at in self.rows if best and sum(at) < sum(best)), key=lambda at: (sum(at), at))
        return next((at for at in smaller if _ties(self.estimate(*at, PSNR, best))), None)


def budget_curves(datasets: Sequence[str], labels: Mapping[str, Label], numbers: Numbers) -> list[BudgetCurve]:
    """Of each data set and method that has rows which differ in the budget or in `prune_error` alone, two or more.

    Args:
        labels: a section's rows -> their labels, which name a setting where it varies.
    """
    curves = []
    for key in KEYS:
        families: dict[Label, list[BudgetRow]] = {}
        for row, label in labels.items():
            value = dict(label.settings).get(key)
            if value is not None:
                member = BudgetRow(row, as_number(value) or math.inf)
                families.setdefault(_without(label, (key,)), []).append(member)
        families = {family: rows for family, rows in families.items() if _several(row.limit for row in rows)}
        for dataset in datasets:
            for family, found in families.items():
                done = (row for row in found if numbers.statuses((dataset,), row.method))
                rows = sorted(done, key=lambda row: _size(key, row.limit))
                if _several(row.limit for row in rows):
                    curves.append(BudgetCurve(dataset, _name(family, families), key, tuple(rows), numbers))
    return curves


def _size(key: str, limit: float) -> float:
    """What ascends with how large a model may be."""
    return -limit if key == PRUNED and math.isfinite(limit) else limit


def _several(limits: Iterable[float]) -> bool:
    """Whether there are two budgets or more, beside no budget."""
    return sum(map(math.isfinite, limits)) > 1


def budget_maps(datasets: Sequence[str], labels: Mapping[str, Label], numbers: Numbers) -> list[BudgetMap]:
    """Of each data set and method whose rows differ in the two sets' size limits alone, two of each or more."""
    families: dict[Label, dict[tuple[int, int], str]] = {}
    for row, label in labels.items():
        limits = [as_number(dict(label.settings).get(key, "")) for key in MAP_KEYS]
        if all(limit is not None and math.isfinite(limit) for limit in limits):
            base, env = (int(limit or 0) for limit in limits)
            families.setdefault(_without(label, MAP_KEYS), {})[base, env] = row
    families = {family: rows for family, rows in families.items() if _is_grid(rows)}
    maps = []
    for dataset in datasets:
        for family, rows in families.items():
            tried = {at: row for at, row in rows.items() if numbers.statuses((dataset,), row)}
            if _is_grid(tried):
                maps.append(BudgetMap(dataset, _name(family, families), tried, numbers))
    return maps


def _is_grid(places: Collection[tuple[int, int]]) -> bool:
    """Whether there are two size limits or more of each set."""
    base, env = {at[0] for at in places}, {at[1] for at in places}
    return min(len(base), len(env)) > 1


def _ties(change: Estimate) -> bool:
    """Whether a change in PSNR from the best is shown to be no larger loss than TIED_DB, of runs that all finished."""
    return change.complete and Comparison(change).as_good(TIED_DB)


def _without(label: Label, keys: Sequence[str]) -> Label:
    return Label(label.name, tuple(item for item in label.settings if item[0] not in keys))


def _name(family: Label, families: Iterable[Label]) -> str:
    """The method's name alone where that tells the families apart."""
    return family.name if [other.name for other in families].count(family.name) == 1 else str(family)
