"""A table of a page: scores after fewer and after more steps, of runs that differ in nothing else."""

from __future__ import annotations

from functools import reduce

import pandas as pd

from .csv_file import NoRunsError
from .kept_runs import FULL, KeptRuns, column_of
from .tables import arranged, capital, places_of, printed

ALIKE = ["scene", "method", "seed"]


def lengths(
    rows: pd.DataFrame, name: str, steps: str, metric: str = "psnr", region: str = FULL, method: str = ""
) -> str:
    """A row a scene, one of their mean, a column a method: `before → after`, of the seeds that all lengths have.

    Args:
        rows: as `read_kept` gives them.
        steps: the lengths, `7000,30000`.
        method: those alone, `envmap,envgs`; without, all that have each length.
    """
    column = column_of(metric, region)
    wanted = {"method": method} if method else {}
    parts = [KeptRuns.chosen(name, rows, wanted | {"steps": count}).rows for count in steps.split(",")]
    runs = [pd.MultiIndex.from_frame(part[ALIKE]) for part in parts]
    shared = reduce(pd.MultiIndex.intersection, runs)
    if shared.empty:
        raise NoRunsError(f"{name} has no run of one scene, method and seed with each of steps={steps}")
    same = [KeptRuns(name, part[own.isin(shared)]) for part, own in zip(parts, runs, strict=True)]
    places = places_of(same[0].having(column))
    tables = [printed(each, column, places) for each in same]
    cells = {
        method: list(map(" → ".join, zip(*(table[method] for table in tables), strict=True))) for method in tables[0]
    }
    what = f"{capital(column.axis)}, after fewer → after more steps of the same seed"
    caption = KeptRuns(name, pd.concat([each.rows for each in same])).caption(what)
    return f"{arranged(places, cells, down=True)}\n{caption}\n"
