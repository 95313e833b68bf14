"""Ladders: the methods of one scene, each with a part more than the one before, and which of them the scene needs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import Literal

from .estimates import Estimate, Numbers
from .labels import Label, method_order
from .runs import Run
from .settings import as_number
from .statistics import FEWEST_SEEDS

RUNGS = {  # method -> the part that it adds, from the ground up
    "2dgs_tuned": "2DGS",
    "envmap": "+ environment map",
    "envgs_no_joint": "+ environment Gaussians",
    "envgs": "+ joint optimization",
}
SAME_FRAME_TIME = 0.05  # the share by which a frame may take longer and still count as equally cheap

Verdict = Literal["best", "within", "tied", "behind", "undecided", "failed"]
Conditions = Mapping[str, str]  # settings that several rungs have, the steps among them


@dataclass(frozen=True)
class Criterion:
    """A score by which a rung may be worse than the best, and by how much."""

    metric: str
    sign: int  # 1 where more is better, -1 where less is
    tolerance: float

    def lost(self, difference: Estimate) -> tuple[float, float] | None:
        """The ends of what is lost (positive: worse), of a difference to the best; None from too few seeds."""
        if difference.done < FEWEST_SEEDS or difference.interval is None:
            return None
        low, high = sorted(-self.sign * end for end in difference.interval)
        return low, high


PSNR = Criterion("psnr", 1, 0.1)
PERCEPTUAL = (Criterion("lpips", -1, 0.005), Criterion("flip", -1, 0.005))  # the first that all candidates have counts


@dataclass(frozen=True)
class Rung:
    name: str  # of RUNGS
    method: str  # its row in the tables

    @property
    def part(self) -> str:
        return RUNGS[self.name]


@dataclass(frozen=True)
class Ladder:
    """Rungs of one data set that were trained alike, from the ground up; every difference is paired by seed.

    Attributes:
        settings: what sets this ladder apart from others of the data set, as "key=value".
        passed_over: rows of the same rungs with other settings of their own.
    """

    numbers: Numbers
    dataset: str
    settings: str
    rungs: tuple[Rung, ...]
    passed_over: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        return f"{self.dataset} [{self.settings}]" if self.settings else self.dataset

    def value(self, rung: Rung, metric: str, region: str = "full") -> Estimate:
        return self.numbers.estimate((self.dataset,), rung.method, region, metric)

    def difference(self, rung: Rung, other: Rung | None, metric: str, region: str = "full") -> Estimate:
        """The rung minus the other, over the seeds on which both finished; empty where there is no other."""
        if other is None:
            return Estimate()
        return self.numbers.estimate((self.dataset,), rung.method, region, metric, other.method)

    def below(self, rung: Rung) -> Rung | None:
        """The next rung below of which any run finished."""
        lower = self.rungs[: self.rungs.index(rung)]
        return next((other for other in reversed(lower) if self.finished(other)), None)

    def finished(self, rung: Rung) -> int:
        return self._statuses(rung)[0]

    def attempts(self, rung: Rung) -> int:
        return self._statuses(rung)[1]

    def _statuses(self, rung: Rung) -> tuple[int, int]:
        found = self.numbers.statuses((self.dataset,), rung.method)
        return found["ok"], found.total()

    @cached_property
    def candidates(self) -> tuple[Rung, ...]:
        """Those that may be taken: every run finished, and there are enough."""
        return tuple(
            rung
            for rung in self.rungs
            if self.finished(rung) == self.attempts(rung) and self.value(rung, "psnr").done >= FEWEST_SEEDS
        )

    @cached_property
    def best(self) -> Rung | None:
        """The candidate with the highest mean PSNR, the lowest such rung."""
        return max(self.candidates, key=lambda rung: self.value(rung, "psnr").mean or 0, default=None)

    @cached_property
    def criteria(self) -> tuple[Criterion, ...]:
        """PSNR, and beside it the first perceptual score that every candidate has of every run."""
        for criterion in PERCEPTUAL:
            if all(self.value(rung, criterion.metric).complete for rung in self.candidates):
                return PSNR, criterion
        return (PSNR,)

    def against_best(self, rung: Rung, criterion: Criterion) -> Estimate:
        return self.difference(rung, self.best, criterion.metric)

    def verdict(self, rung: Rung) -> Verdict:
        """How the rung stands to the best.

        `behind`: by some criterion the interval of what is lost lies above the tolerance; `within`: by every
        criterion it ends below it; `tied`: it holds the tolerance, so that neither is shown.
        """
        if rung == self.best:
            return "best"
        if self.finished(rung) < self.attempts(rung):
            return "failed"
        lost = [(criterion.lost(self.against_best(rung, criterion)), criterion) for criterion in self.criteria]
        known = [(ends, criterion.tolerance) for ends, criterion in lost if ends is not None]
        if rung not in self.candidates or len(known) < len(lost):
            return "undecided"
        if any(low > tolerance for (low, _), tolerance in known):
            return "behind"
        return "within" if all(high <= tolerance for (_, high), tolerance in known) else "tied"

    @cached_property
    def recommended(self) -> Rung | None:
        """The cheapest that is not shown to be worse than the best; None where nothing can be compared with it."""
        verdicts = {rung: self.verdict(rung) for rung in self.candidates}
        if not {"within", "tied", "behind"} & set(verdicts.values()):
            return None
        return self.cheapest([rung for rung, found in verdicts.items() if found in ("best", "within", "tied")])

    def cheapest(self, rungs: Sequence[Rung]) -> Rung:
        """Of those that draw as fast as the fastest, within SAME_FRAME_TIME, the one with the fewest primitives.

        Args:
            rungs: candidates, not none.
        """
        frame_ms = {rung: self._cost(rung, "frame_ms") for rung in rungs}
        most = (1 + SAME_FRAME_TIME) * min(frame_ms.values())
        return min((rung for rung in rungs if frame_ms[rung] <= most), key=lambda rung: self._cost(rung, "primitives"))

    def _cost(self, rung: Rung, metric: str) -> float:
        return float(self.value(rung, metric).mean or 0)


def ladders(numbers: Numbers, runs: Iterable[tuple[str, Label, Run]]) -> list[Ladder]:
    """The ladders of two rungs and more among (data set's label, method's label, run), by data set.

    Rungs of a ladder agree in the steps and in every setting that varies and that several of them have. Of rows of one
    rung that differ in a setting of its own, the ladder has that with the most runs.
    """
    rows: dict[str, dict[str, tuple[Label, int]]] = {}
    for dataset, label, run in runs:
        if label.name in RUNGS:
            rows.setdefault(dataset, {})[str(label)] = label, run.record.steps
    return [ladder for dataset in sorted(rows) for ladder in _of_dataset(numbers, dataset, rows[dataset])]


def _of_dataset(numbers: Numbers, dataset: str, rows: dict[str, tuple[Label, int]]) -> list[Ladder]:
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
        rungs = tuple(Rung(name, chosen[name]) for name in RUNGS if name in chosen)
        settings = ", ".join(f"{key.rsplit('.', 1)[-1]}={conditions[key]}" for key in sorted(varying & {*conditions}))
        if len(rungs) > 1:
            others = tuple(row for row in given if row in fitting and row not in chosen.values())
            found.append(Ladder(numbers, dataset, settings, rungs, others))
    return found


def _whole(given: Iterable[Conditions]) -> list[Conditions]:
    """The different conditions that are no part of others, numbers ascending."""
    distinct = list({tuple(sorted(one.items())): one for one in given}.values())
    return sorted((one for one in distinct if not any(one.items() < other.items() for other in distinct)), key=_order)


def _order(conditions: Conditions) -> list[tuple[str, float, str]]:
    numbers = {key: as_number(value) for key, value in conditions.items()}
    return [(key, inf if (number := numbers[key]) is None else number, conditions[key]) for key in sorted(conditions)]
