"""ladder.csv and ladder-summary.csv: every number of the ladders, tidy, and what they recommend."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pandas as pd

from envgs_bench.parts import BASE, ENV

from ..numbers.estimates import Estimate
from ..numbers.ladder import Ladder, Rung
from .columns import COSTS, SCORES
from .ladder import SCORED_REGIONS
from .recommendations import recommendation

COLUMNS = [
    *("dataset", "settings", "rung", "method", "region", "quantity", "against"),
    *("value", "low", "high", "std", "runs"),
]
SUMMARY_COLUMNS = ["dataset", "settings", "take", "best", "judged_by", "sentence"]
NUMBERS = ("value", "low", "high", "std")
SETS = tuple(f"primitives_{name}" for name in (BASE, ENV))


def rungs_table(ladders: Sequence[Ladder]) -> pd.DataFrame:
    """A row a number, in the records' units: `rung` counts from the ground, 1, and `runs` how many stand behind it.

    Where `against` names a method, the value is the rung's minus that method's, over the seeds on which both finished:
    of the rung below and of the best.
    """
    rows: list[tuple[object, ...]] = []
    for ladder in ladders:
        for number, rung in enumerate(ladder.rungs, 1):
            place = (ladder.dataset, ladder.settings, number, rung.method)
            for region, quantity, against, estimate in _estimates(ladder, rung):
                if estimate.mean is not None:
                    ends = estimate.interval or (None, None)
                    numbers = (float(estimate.mean), *ends, estimate.spread, estimate.done)
                    rows.append((*place, region, quantity, against, *numbers))
    return pd.DataFrame(rows, columns=COLUMNS).astype(dict.fromkeys(NUMBERS, "float64"))


def _estimates(ladder: Ladder, rung: Rung) -> Iterator[tuple[str, str, str, Estimate]]:
    """region, quantity, what is subtracted, estimate."""
    for region in ("full", *SCORED_REGIONS):
        for score in SCORES:
            yield region, score.metric, "", ladder.value(rung, score.metric, region)
            for other in dict.fromkeys((ladder.below(rung), ladder.best)):
                if other not in (None, rung):
                    found = ladder.difference(rung, other, score.metric, region)
                    yield region, score.metric, other.method if other else "", found
    for quantity in (*(column.metric for column in COSTS), *SETS):
        yield "full", quantity, "", ladder.value(rung, quantity)


def recommendations_table(ladders: Sequence[Ladder]) -> pd.DataFrame:
    """A row a ladder: the method to take, "" where there is no verdict, and the sentence that says so."""
    rows = []
    for ladder in ladders:
        found = recommendation(ladder)
        best = ladder.best.method if ladder.best else ""
        judged = " ".join(criterion.metric for criterion in ladder.criteria) if found.method else ""
        rows.append((ladder.dataset, ladder.settings, found.method, best, judged, found.text))
    return pd.DataFrame(rows, columns=SUMMARY_COLUMNS)
