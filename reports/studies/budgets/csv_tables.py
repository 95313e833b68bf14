"""budgets.csv: every number of the budgets, tidy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pandas as pd

from ...numbers.estimates import Estimate
from .budgets import COSTS, PSNR, QUANTITIES, BudgetCurve, BudgetMap

COLUMNS = ["dataset", "method", "budget", "limit", "env_limit", "quantity", "value", "low", "high", "std", "runs"]
NUMBERS = ("limit", "env_limit", "value", "low", "high", "std")
MAP = "max_primitives × env_max_primitives"


def budgets_table(curves: Sequence[BudgetCurve], maps: Sequence[BudgetMap]) -> pd.DataFrame:
    """A row a number: every score and cost of every budget, with its change from the curve's best, paired by seed.

    `limit` is infinite without a budget; of a map it is the base's and `env_limit` the environment's. `knee` has the
    knee's limit as its value, empty where there is none, `bd_rate:<method>` a share without a limit.
    """
    rows = [row for curve in curves for row in _curve_rows(curve)]
    rows += [row for curve in curves for row in _rate_rows(curve, curves)]
    rows += [row for found in maps for row in _map_rows(found)]
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


def _rate_rows(curve: BudgetCurve, curves: Sequence[BudgetCurve]) -> Iterator[tuple[object, ...]]:
    """The BD-rate against every other curve of the data set and the kind of budget, `bd_rate:<method>`."""
    for anchor in curves:
        if anchor is not curve and (anchor.dataset, anchor.key) == (curve.dataset, curve.key):
            rate = curve.rate_against(anchor)
            if rate is not None:
                place = (curve.dataset, curve.method, curve.key, None, None, f"bd_rate:{anchor.method}")
                yield (*place, rate, None, None, None, None)


def _map_rows(found: BudgetMap) -> Iterator[tuple[object, ...]]:
    for base, env in sorted(found.rows):
        for quantity in (*QUANTITIES, *COSTS):
            place = (found.dataset, found.method, MAP, base, env)
            yield from _number(place, quantity.name, found.estimate(base, env, quantity))


def _number(place: tuple[object, ...], name: str, estimate: Estimate) -> Iterator[tuple[object, ...]]:
    if estimate.mean is not None:
        ends = estimate.interval or (None, None)
        yield (*place, name, float(estimate.mean), *ends, estimate.spread, estimate.done)
