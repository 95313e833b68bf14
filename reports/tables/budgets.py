"""Budgets of a section: their curves and maps, in sentences and as budgets.csv."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import pandas as pd

from ..numbers.budgets import (
    COSTS,
    PSNR,
    QUANTITIES,
    TIED_DB,
    BudgetCurve,
    BudgetMap,
    BudgetRow,
    budget_curves,
    budget_maps,
)
from ..numbers.estimates import Estimate
from .sections import Section

COLUMNS = ["dataset", "method", "budget", "limit", "env_limit", "quantity", "value", "low", "high", "std", "runs"]
NUMBERS = ("limit", "env_limit", "value", "low", "high", "std")
MAP = "max_primitives × env_max_primitives"


@dataclass(frozen=True)
class Budgets:
    curves: tuple[BudgetCurve, ...]
    maps: tuple[BudgetMap, ...]

    def __bool__(self) -> bool:
        return bool(self.curves or self.maps)


def budgets_of(section: Section) -> Budgets:
    """The section's rows that differ in what their models may have alone."""
    labels = {item.method: item.label for item in section.runs}
    ordered = {method: labels[method] for method in section.methods}
    return Budgets(
        tuple(budget_curves(section.datasets, ordered, section.numbers)),
        tuple(budget_maps(section.datasets, ordered, section.numbers)),
    )


def limit_text(curve: BudgetCurve, row: BudgetRow) -> str:
    """The budget with its unit, as `4,000 primitives` or `0.5 MB`."""
    if not math.isfinite(row.limit):
        return "no budget"
    return f"{row.limit:,.0f} primitives" if curve.key.endswith("primitives") else f"{row.limit:g} MB"


def curve_sentence(curve: BudgetCurve) -> str:
    """Where the method's knee is, or why it has none."""
    knee = curve.knee
    if knee.row is None:
        best = f"; best: {limit_text(curve, knee.best)}" if knee.best else ""
        return f"{curve.method}: no knee, {knee.why}{best}."
    if knee.row == knee.best:
        return f"{curve.method}: {limit_text(curve, knee.row)}, the best; any less may lose more than {TIED_DB:g} dB."
    interval, mean = knee.loss.interval, knee.loss.mean
    assert interval is not None
    assert mean is not None
    assert knee.best is not None
    return (
        f"{curve.method}: {limit_text(curve, knee.row)}, {-mean:.2f} dB below the best "
        f"({limit_text(curve, knee.best)}), by the interval at most {max(0.0, -interval.low):.2f}."
    )


def map_sentence(found: BudgetMap) -> str:
    """Which bounds were best, and which smaller ones are as good."""
    if found.best is None:
        return f"{found.method}: no run finished."
    base, env = found.best
    mean = found.estimate(base, env).mean
    words = f"{found.method}: best with at most {base:,} in the base and {env:,} in the environment, {mean:.2f} dB"
    if found.knee is None:
        return f"{words}."
    lost = found.estimate(*found.knee, PSNR, found.best)
    assert lost.mean is not None
    base, env = found.knee
    return f"{words}; {base:,} and {env:,} are {-lost.mean:.2f} below."


def budgets_table(budgets: Budgets) -> pd.DataFrame:
    """A row a number: every score and cost of every budget, with its change from the curve's best, paired by seed.

    `limit` is infinite without a budget; of a map it is the base's and `env_limit` the environment's. `knee` has the
    knee's limit as its value, empty where there is none.
    """
    rows = [row for curve in budgets.curves for row in _curve_rows(curve)]
    rows += [row for found in budgets.maps for row in _map_rows(found)]
    return pd.DataFrame(rows, columns=COLUMNS).astype(dict.fromkeys(NUMBERS, "float64"))


def _curve_rows(curve: BudgetCurve) -> Iterator[tuple[object, ...]]:
    place = (curve.dataset, curve.method, curve.key)
    knee = curve.knee
    for row in curve.rows:
        for quantity in (*QUANTITIES, *COSTS):
            yield from _number((*place, row.limit, None), quantity.name, curve.estimate(row, quantity))
        if knee.best is not None:
            yield from _number((*place, row.limit, None), "change_psnr", curve.estimate(row, PSNR, knee.best))
    if knee.row is not None:
        yield (
            *place,
            knee.row.limit,
            None,
            "knee",
            knee.row.limit,
            None,
            None,
            None,
            curve.estimate(knee.row, PSNR).done,
        )


def _map_rows(found: BudgetMap) -> Iterator[tuple[object, ...]]:
    for base, env in sorted(found.rows):
        for quantity in (*QUANTITIES, *COSTS):
            place = (found.dataset, found.method, MAP, base, env)
            yield from _number(place, quantity.name, found.estimate(base, env, quantity))


def _number(place: tuple[object, ...], name: str, estimate: Estimate) -> Iterator[tuple[object, ...]]:
    if estimate.mean is not None:
        ends = estimate.interval or (None, None)
        yield (*place, name, float(estimate.mean), *ends, estimate.spread, estimate.done)
