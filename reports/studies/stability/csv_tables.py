"""stability.csv and stability-summary.csv: every number of the study, tidy."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pandas as pd

from ...numbers.estimates import Estimate
from ...numbers.intervals import Interval
from .breaking_points import breaking_points
from .corruption_error import mean_corruption_error
from .perturbed_runs import FAILURES, QUANTITIES, SURVIVED, UNTRIED
from .profiles import DROPS, drops, improvement_tasks, probability_of_improvement, profile, survival
from .seed_distances import SEED_DISTANCES
from .stability import Case, Cell, Stability

COLUMNS = ["dataset", "kind", "severity", "level", "method", "quantity", "value", "low", "high", "std", "runs"]
SUMMARY_COLUMNS = ["dataset", "kind", "method", "against", "quantity", "at", "value", "low", "high", "runs"]
NUMBERS = ("at", "value", "low", "high", "std")
Numbers = tuple[str, float | None, Interval | None, float | None, int]  # quantity, value, interval, spread, runs


def cells_table(stability: Stability) -> pd.DataFrame:
    """A row a number of the failure matrix and the tables, unperturbed runs as severity 0.

    `runs` is how many stand behind a value: all that were tried for counts and shares, finished ones or pairs of a
    perturbed run and its partner for means. `change_<quantity>` is the run minus its partner, `gain_<quantity>` the
    run minus the baseline's, perturbed alike; `seeds_<quantity>` lies between the models of two seeds.
    """
    rows: list[tuple[object, ...]] = []
    for case in stability.cases:
        for method in stability.methods_of(case):
            for severity in (0, *stability.severities(case)):
                if stability.runs(case, severity, method):
                    place = (*case, severity, stability.level(case, severity) if severity else "", method)
                    for quantity, value, interval, spread, runs in _numbers(stability, case, severity, method):
                        rows.append((*place, quantity, value, *(interval or (None, None)), spread, runs))
    return _frame(rows, COLUMNS)


def _numbers(stability: Stability, case: Case, severity: int, method: str) -> Iterator[Numbers]:
    cell = stability.cell(case, severity, method)
    yield from _outcomes(cell)
    if severity:
        yield "without_partner", cell.unpaired, None, None, len(cell.tried)
    for quantity in QUANTITIES:
        yield _mean(quantity, cell.values(quantity))
        if severity:
            yield _mean(f"change_{quantity}", cell.change(quantity))
    for quantity in SEED_DISTANCES:
        yield _mean(quantity, cell.seed_distance(quantity))
    if stability.baseline(case) not in (None, method):
        behind, compared = cell.behind
        yield "behind_baseline", behind, None, None, compared
        for quantity in ("psnr", "psnr_reflective"):
            yield _mean(f"gain_{quantity}", stability.gain(case, severity, method, quantity))


def _outcomes(cell: Cell) -> Iterator[Numbers]:
    tried = len(cell.tried)
    for name in (SURVIVED, *FAILURES, *UNTRIED):
        yield name, cell.outcomes[name], None, None, tried
    yield "failure_share", cell.failures / tried if tried else None, cell.failure_interval, None, tried
    yield "failed_silently", cell.silent, None, None, tried
    for kind, count in sorted(cell.warnings.items()):
        yield f"warned_{kind}", count, None, None, len(cell.runs)


def _mean(quantity: str, estimate: Estimate) -> Numbers:
    mean = None if estimate.mean is None else float(estimate.mean)
    return quantity, mean, estimate.interval, estimate.spread, estimate.done


def summary_table(stability: Stability) -> pd.DataFrame:
    """Breaking points by case; the probability of improvement and the profiles over all cases, by method.

    `at` is the share of the gain that is left for a breaking point, dB for `profile`, the severity for `survival`. A
    severity of `inf` was not reached by those that were tried. `runs` counts seeds for breaking points, else tasks.
    """
    rows: list[tuple[object, ...]] = []
    for case in stability.cases:
        for method in stability.methods_of(case):
            for point in breaking_points(stability, case, method):
                ends = point.interval or (None, None)
                name = "breaking_severity"
                rows.append(
                    (*case, method, stability.baseline(case), name, point.share, point.severity, *ends, point.seeds)
                )
    baselines = {b for case in stability.cases if (b := stability.baseline(case)) is not None}
    for method in stability.methods:
        if tasks := improvement_tasks(stability, method):
            share, interval = probability_of_improvement(tasks)
            against = " or ".join(sorted(baselines - {method}))
            name = "probability_of_improvement"
            rows.append(("", "", method, against, name, math.nan, share, *(interval or (None, None)), len(tasks)))
        if (found := mean_corruption_error(stability, method)) is not None:
            error, kinds = found
            against = " or ".join(sorted(baselines))
            name = "mean_corruption_error"
            rows.append(("", "", method, against, name, math.nan, error, math.nan, math.nan, kinds))
        lost = drops(stability, method)
        severities = sorted({s for case in stability.cases for s in stability.severities(case)})
        curves = [("profile", drop, profile(lost, drop)) for drop in DROPS]
        curves += [("survival", severity, survival(stability, method, severity)) for severity in severities]
        for name, at, estimate in curves:
            if estimate.mean is not None:
                ends = estimate.interval or (None, None)
                rows.append(("", "", method, "", name, at, float(estimate.mean), *ends, estimate.done))
    return _frame(rows, SUMMARY_COLUMNS)


def _frame(rows: list[tuple[object, ...]], columns: list[str]) -> pd.DataFrame:
    """Numbers are numbers also where a whole column of them is missing."""
    return pd.DataFrame(rows, columns=columns).astype({name: "float64" for name in NUMBERS if name in columns})
