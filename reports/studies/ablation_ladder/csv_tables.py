"""ablation-ladder.csv and -summary.csv: every number of the ladders, tidy, and what they recommend."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pandas as pd

from envgs_bench.parts import BASE, ENV

from ...numbers.estimates import Estimate
from ...tables.columns import COSTS, SCORES
from .ladder import Ladder, Variant
from .recommendation import recommendation
from .table import SCORED_REGIONS

COLUMNS = [
    *("dataset", "settings", "step", "method", "region", "quantity", "against"),
    *("value", "low", "high", "std", "runs"),
]
SUMMARY_COLUMNS = ["dataset", "settings", "take", "best", "judged_by", "sentence"]
NUMBERS = ("value", "low", "high", "std")
SETS = tuple(f"primitives_{name}" for name in (BASE, ENV))


def variants_table(ladders: Sequence[Ladder]) -> pd.DataFrame:
    """A row a number, in the records' units: `step` counts from the baseline, 1, and `runs` how many stand behind it.

    Where `against` names a method, the value is the variant's minus that method's, over the seeds that finished both:
    of the variant before and of the best.
    """
    rows: list[tuple[object, ...]] = []
    for ladder in ladders:
        for number, variant in enumerate(ladder.variants, 1):
            place = (ladder.dataset, ladder.settings, number, variant.method)
            for region, quantity, against, estimate in _estimates(ladder, variant):
                if estimate.mean is not None:
                    ends = estimate.interval or (None, None)
                    numbers = (float(estimate.mean), *ends, estimate.spread, estimate.done)
                    rows.append((*place, region, quantity, against, *numbers))
    return pd.DataFrame(rows, columns=COLUMNS).astype(dict.fromkeys(NUMBERS, "float64"))


def _estimates(ladder: Ladder, variant: Variant) -> Iterator[tuple[str, str, str, Estimate]]:
    """region, quantity, what is subtracted, estimate."""
    for region in ("full", *SCORED_REGIONS):
        for score in SCORES:
            yield region, score.metric, "", ladder.value(variant, score.metric, region)
            for other in dict.fromkeys((ladder.before(variant), ladder.best)):
                if other not in (None, variant):
                    found = ladder.difference(variant, other, score.metric, region)
                    yield region, score.metric, other.method if other else "", found
    for quantity in (*(column.metric for column in COSTS), *SETS):
        yield "full", quantity, "", ladder.value(variant, quantity)


def recommendations_table(ladders: Sequence[Ladder]) -> pd.DataFrame:
    """A row a ladder: the method to take, "" where there is no verdict, and the sentence that says so."""
    rows = []
    for ladder in ladders:
        found = recommendation(ladder)
        best = ladder.best.method if ladder.best else ""
        judged = " ".join(criterion.metric for criterion in ladder.criteria) if found.method else ""
        rows.append((ladder.dataset, ladder.settings, found.method, best, judged, found.text))
    return pd.DataFrame(rows, columns=SUMMARY_COLUMNS)
