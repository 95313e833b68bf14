"""Stability: what perturbations did to the methods of a report, from the records alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

from envgs_bench.settings import Gates

from ...numbers.comparison import Comparison
from ...numbers.estimates import Estimate
from ...numbers.intervals import COVERAGE, Interval
from ...numbers.labels import Label, method_order
from ...numbers.runs import Run
from ...tables.sections import LabeledRun
from .perturbed_runs import FAILURES, UNTRIED, PerturbedRun, gates_of, value
from .seed_distances import seed_distances

Case = tuple[str, str]  # data set, kind of perturbation


@dataclass(frozen=True)
class Cell:
    """The runs of one method under one perturbation of one severity, by ascending seed."""

    runs: tuple[PerturbedRun, ...] = ()

    @cached_property
    def tried(self) -> tuple[PerturbedRun, ...]:
        """Those that say something of the method."""
        return tuple(run for run in self.runs if run.outcome not in UNTRIED)

    @cached_property
    def outcomes(self) -> Counter[str]:
        return Counter(run.outcome for run in self.runs)

    @property
    def failures(self) -> int:
        return sum(self.outcomes[name] for name in FAILURES)

    @property
    def silent(self) -> int:
        """Failures that neither a status nor a warning tells."""
        return sum(run.silent for run in self.tried)

    @property
    def unpaired(self) -> int:
        """Runs without a finished partner: what they lost is unknown."""
        return sum(not run.paired for run in self.tried)

    @property
    def failure_interval(self) -> Interval | None:
        """Of the share of failures (Wilson 1927): a bootstrap of equal outcomes would claim to be certain."""
        if not self.tried:
            return None
        from scipy.stats import binomtest  # takes a second to import

        found = binomtest(self.failures, len(self.tried)).proportion_ci(COVERAGE, method="wilson")
        return Interval(float(found.low), float(found.high))

    @property
    def behind(self) -> tuple[int, int]:
        """How many runs are behind their rival, of how many that have one."""
        known = [run.behind for run in self.tried if run.behind is not None]
        return sum(known), len(known)

    @property
    def warnings(self) -> Counter[str]:
        """Kind of warning -> in how many runs it was recorded."""
        return Counter(kind for run in self.runs for kind in {warning.kind for warning in run.record.warnings})

    def values(self, quantity: str) -> Estimate:
        """Of the finished runs."""
        return self._estimate([value(one.run, quantity) for one in self.tried])

    def change(self, quantity: str) -> Estimate:
        """The perturbed run minus its partner of the same seed."""
        return self._estimate([None if (d := run.drop(quantity)) is None else -d for run in self.tried])

    def seed_distance(self, quantity: str) -> Estimate:
        """One of SEED_DISTANCES, over the finished runs that another seed's can be compared with."""
        return self._estimate(self._seed_distances[quantity])

    @cached_property
    def _seed_distances(self) -> dict[str, tuple[float, ...]]:
        return seed_distances([one.run for one in self.tried])

    def _estimate(self, found: Sequence[float | None]) -> Estimate:
        known = tuple(number for number in found if number is not None)
        return Estimate(strata=(known,) if known else (), done=len(known), expected=len(self.tried))


class Stability:
    """The perturbed runs of one section, and the unperturbed ones beside them.

    Of several runs of the same data set, method, perturbation and seed, the newest counts.
    """

    def __init__(self, runs: Iterable[LabeledRun]):
        self._runs: dict[tuple[str, str, str, int], dict[int, Run]] = {}
        self._labels: dict[str, Label] = {}
        self._cells: dict[tuple[Case, int, str], Cell] = {}
        for item in sorted(runs, key=lambda item: item.run.record.provenance.finished):
            perturbed = item.run.record.perturbation
            kind, severity = (perturbed.kind, perturbed.severity) if perturbed else ("", 0)
            seeds = self._runs.setdefault((item.dataset, item.method, kind, severity), {})
            seeds[item.run.record.seed] = item.run
            self._labels[item.method] = item.label

    @cached_property
    def cases(self) -> list[Case]:
        return sorted({(dataset, kind) for dataset, _, kind, severity in self._runs if severity})

    @cached_property
    def datasets(self) -> list[str]:
        return sorted({dataset for dataset, _ in self.cases})

    @cached_property
    def methods(self) -> list[str]:
        """Those that have perturbed runs, in the tables' order."""
        found = {method for _, method, _, severity in self._runs if severity}
        return sorted(found, key=lambda method: method_order(self._labels[method]))

    def methods_of(self, case: Case) -> list[str]:
        found = {m for d, m, kind, severity in self._runs if severity and (d, kind) == case}
        return [method for method in self.methods if method in found]

    def severities(self, case: Case) -> list[int]:
        """Those that were tried, without 0."""
        return sorted({severity for dataset, _, kind, severity in self._runs if severity and (dataset, kind) == case})

    def level(self, case: Case, severity: int) -> str:
        """What the severity does, in the words of the first record that has it."""
        for (dataset, _, kind, other), seeds in self._runs.items():
            for run in seeds.values() if (dataset, kind, other) == (*case, severity) else ():
                return run.record.perturbation.level if run.record.perturbation else ""
        return ""

    def runs(self, case: Case, severity: int, method: str) -> dict[int, Run]:
        """By seed, ascending; severity 0 are the unperturbed ones."""
        dataset, kind = case
        found = self._runs.get((dataset, method, kind if severity else "", severity), {})
        return {seed: found[seed] for seed in sorted(found)}

    def cell(self, case: Case, severity: int, method: str) -> Cell:
        """The runs of a method at a severity, 0 for unperturbed."""
        key = (case, severity, method)
        if key not in self._cells:
            self._cells[key] = self._cell(*key)
        return self._cells[key]

    def _cell(self, case: Case, severity: int, method: str) -> Cell:
        partners = self.runs(case, 0, method) if severity else {}
        baseline = self.baseline(case)
        rivals = self.runs(case, severity, baseline) if baseline not in (None, method) else {}
        own = self.runs(case, severity, method)
        return Cell(tuple(PerturbedRun(run, partners.get(seed), rivals.get(seed)) for seed, run in own.items()))

    def baseline(self, case: Case) -> str | None:
        """The method that others have to be as good as, by the gates that the case's runs carry; None: none was run."""
        named = {gates.baseline for gates in self.gates(case)}
        found = [method for method in self.methods_of(case) if self._labels[method].name in named]
        return found[0] if len(found) == 1 else None

    def gates(self, case: Case) -> list[Gates]:
        """The different gates that the case's runs carry."""
        records = [
            run.record for (d, _, kind, s), seeds in self._runs.items() if s and (d, kind) == case
            for run in seeds.values()
        ]  # fmt: skip
        found = {gates.model_dump_json(): gates for record in records if (gates := gates_of(record)) is not None}
        return [found[key] for key in sorted(found)]

    def comparison(self, case: Case, severity: int, method: str) -> Comparison:
        """The method against the baseline by PSNR, perturbed alike."""
        return Comparison(self.gain(case, severity, method))

    def gain(self, case: Case, severity: int, method: str, quantity: str = "psnr") -> Estimate:
        """The method minus the baseline, perturbed alike and of the same seed; over seeds on which both finished."""
        baseline = self.baseline(case)
        theirs = self.runs(case, severity, baseline) if baseline is not None else {}
        own = {seed: run for seed, run in self.runs(case, severity, method).items() if seed in theirs}
        pairs = [(value(run, quantity), value(theirs[seed], quantity)) for seed, run in own.items()]
        known = tuple(a - b for a, b in pairs if a is not None and b is not None)
        return Estimate(strata=(known,) if known else (), done=len(known), expected=len(own))
