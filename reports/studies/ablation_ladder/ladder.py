"""Ablation ladders: variants of one method on one scene, each with a part more than the one before."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import Literal

from envgs_bench.parts import MethodCard

from ...numbers.comparison import FEWEST_SEEDS, Comparison
from ...numbers.estimates import Estimate, Numbers
from ...numbers.labels import Label, method_order
from ...numbers.runs import Run
from ...numbers.settings import as_number

SAME_FRAME_TIME = 0.05  # the share by which a frame may take longer and still count as equally cheap

Verdict = Literal["best", "within", "tied", "behind", "undecided", "failed"]
Conditions = Mapping[str, str]  # settings that several variants have, the steps among them


@dataclass(frozen=True)
class Criterion:
    """A score by which a variant may be worse than the best, and by how much."""

    metric: str
    sign: int  # 1 where more is better, -1 where less is
    tolerance: float

    def comparison(self, difference: Estimate) -> Comparison:
        return Comparison(difference, self.sign)


PSNR = Criterion("psnr", 1, 0.1)
PERCEPTUAL = (Criterion("lpips", -1, 0.005), Criterion("flip", -1, 0.005))  # the first that all candidates have counts


@dataclass(frozen=True)
class Variant:
    """A step of a ladder; the first is its baseline.

    Attributes:
        name: the method's.
        method: its row in the tables.
        part: what it adds to the variant before; of the baseline what it is.
    """

    name: str
    method: str
    part: str


@dataclass(frozen=True)
class Ladder:
    """Variants on one data set that were trained alike, from the baseline up; every difference is paired by seed.

    Attributes:
        settings: what sets this ladder apart from others of the data set, as "key=value".
        passed_over: rows of the same methods with other settings of their own.
    """

    numbers: Numbers
    dataset: str
    settings: str
    variants: tuple[Variant, ...]
    passed_over: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        return f"{self.dataset} [{self.settings}]" if self.settings else self.dataset

    def value(self, variant: Variant, metric: str, region: str = "full") -> Estimate:
        return self.numbers.estimate((self.dataset,), variant.method, region, metric)

    def difference(self, variant: Variant, other: Variant | None, metric: str, region: str = "full") -> Estimate:
        """The variant minus the other, over the seeds on which both finished; empty where there is no other."""
        if other is None:
            return Estimate()
        return self.numbers.estimate((self.dataset,), variant.method, region, metric, other.method)

    def before(self, variant: Variant) -> Variant | None:
        """The next variant before it of which any run finished."""
        earlier = self.variants[: self.variants.index(variant)]
        return next((other for other in reversed(earlier) if self.finished(other)), None)

    def finished(self, variant: Variant) -> int:
        return self._statuses(variant)[0]

    def attempts(self, variant: Variant) -> int:
        return self._statuses(variant)[1]

    def _statuses(self, variant: Variant) -> tuple[int, int]:
        found = self.numbers.statuses((self.dataset,), variant.method)
        return found["ok"], found.total()

    @cached_property
    def candidates(self) -> tuple[Variant, ...]:
        """Those that may be taken: every run finished, and there are enough."""
        return tuple(
            variant
            for variant in self.variants
            if self.finished(variant) == self.attempts(variant) and self.value(variant, "psnr").done >= FEWEST_SEEDS
        )

    @cached_property
    def best(self) -> Variant | None:
        """The candidate with the highest mean PSNR, the earliest such variant."""
        return max(self.candidates, key=lambda variant: self.value(variant, "psnr").mean or 0, default=None)

    @cached_property
    def criteria(self) -> tuple[Criterion, ...]:
        """PSNR, and beside it the first perceptual score that every candidate has of every run."""
        for criterion in PERCEPTUAL:
            if all(self.value(variant, criterion.metric).complete for variant in self.candidates):
                return PSNR, criterion
        return (PSNR,)

    def against_best(self, variant: Variant, criterion: Criterion) -> Estimate:
        return self.difference(variant, self.best, criterion.metric)

    def verdict(self, variant: Variant) -> Verdict:
        """How the variant stands to the best.

        `behind`: by some criterion it is shown to be worse by more than the tolerance; `within`: by every criterion it
        is shown to be as good within it; `tied`: neither is shown.
        """
        if variant == self.best:
            return "best"
        if self.finished(variant) < self.attempts(variant):
            return "failed"
        found = [(c.comparison(self.against_best(variant, c)), c.tolerance) for c in self.criteria]
        if variant not in self.candidates or not all(comparison.decided for comparison, _ in found):
            return "undecided"
        if any(comparison.worse(by=tolerance) for comparison, tolerance in found):
            return "behind"
        return "within" if all(comparison.as_good(tolerance) for comparison, tolerance in found) else "tied"

    @cached_property
    def recommended(self) -> Variant | None:
        """The cheapest that is not shown to be worse than the best; None where nothing can be compared with it."""
        verdicts = {variant: self.verdict(variant) for variant in self.candidates}
        if not {"within", "tied", "behind"} & set(verdicts.values()):
            return None
        return self.cheapest([variant for variant, found in verdicts.items() if found in ("best", "within", "tied")])

    def cheapest(self, variants: Sequence[Variant]) -> Variant:
        """Of those that draw as fast as the fastest, within SAME_FRAME_TIME, the one with the fewest primitives.

        Args:
            variants: candidates, not none.
        """
        frame_ms = {variant: self._cost(variant, "frame_ms") for variant in variants}
        most = (1 + SAME_FRAME_TIME) * min(frame_ms.values())
        return min(
            (variant for variant in variants if frame_ms[variant] <= most),
            key=lambda variant: self._cost(variant, "primitives"),
        )

    def _cost(self, variant: Variant, metric: str) -> float:
        return float(self.value(variant, metric).mean or 0)


def ladders(numbers: Numbers, runs: Iterable[tuple[str, Label, Run]], cards: Mapping[str, MethodCard]) -> list[Ladder]:
    """The ladders of two variants and more among (data set's label, method's label, run), by data set.

    Variants of a ladder agree in the steps and in every setting that varies and that several of them have. Of rows of
    one method that differ in a setting of its own, the ladder has that with the most runs.

    Args:
        cards: method -> what it says of itself, its place on a ladder among that.
    """
    rows: dict[tuple[str, str], dict[str, tuple[Label, int]]] = {}
    for dataset, label, run in runs:
        if name := cards[label.name].ladder:
            rows.setdefault((dataset, name), {})[str(label)] = label, run.record.steps
    parts = {name: (card.adds and f"+ {card.adds}") or card.label for name, card in cards.items()}
    found = []
    for dataset, name in sorted(rows):
        steps = sorted((card.step, method) for method, card in cards.items() if card.ladder == name)
        ordered = {method: parts[method] for _, method in steps}
        found += _of_dataset(numbers, dataset, rows[dataset, name], ordered)
    return found


def _of_dataset(
    numbers: Numbers, dataset: str, rows: dict[str, tuple[Label, int]], parts: Mapping[str, str]
) -> list[Ladder]:
    owners: dict[str, set[str]] = {}
    for label, _ in rows.values():
        for key, _ in label.settings:
            owners.setdefault(key, set()).add(label.name)
    shared = {key for key, names in owners.items() if len(names) > 1}
    given: dict[str, Conditions] = {
        row: {key: value for key, value in label.settings if key in shared} | {"steps": str(steps)}
        for row, (label, steps) in rows.items()
    }
    several = _whole(given.values())
    varying = {key for one in several for key in one if len({other.get(key) for other in several}) > 1}
    found = []
    for conditions in several:
        fitting = [row for row, own in given.items() if own.items() <= conditions.items()]
        fitting.sort(key=lambda row: (-numbers.statuses((dataset,), row).total(), method_order(rows[row][0])))
        chosen: dict[str, str] = {}
        for row in fitting:
            chosen.setdefault(rows[row][0].name, row)
        variants = tuple(Variant(name, chosen[name], part) for name, part in parts.items() if name in chosen)
        settings = ", ".join(f"{key.rsplit('.', 1)[-1]}={conditions[key]}" for key in sorted(varying & {*conditions}))
        if len(variants) > 1:
            others = tuple(row for row in given if row in fitting and row not in chosen.values())
            found.append(Ladder(numbers, dataset, settings, variants, others))
    return found


def _whole(given: Iterable[Conditions]) -> list[Conditions]:
    """The different conditions that are no part of others, numbers ascending."""
    distinct = list({tuple(sorted(one.items())): one for one in given}.values())
    return sorted((one for one in distinct if not any(one.items() < other.items() for other in distinct)), key=_order)


def _order(conditions: Conditions) -> list[tuple[str, float, str]]:
    numbers = {key: as_number(value) for key, value in conditions.items()}
    return [(key, inf if (number := numbers[key]) is None else number, conditions[key]) for key in sorted(conditions)]
