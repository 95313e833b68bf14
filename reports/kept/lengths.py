"""A table of a page: scores after fewer and after more steps, of runs that differ in nothing else."""

from __future__ import annotations

import pandas as pd

from .runs_file import NoRunsError
from .tables import FULL, KeptRuns, as_markdown, column_of, heading, places_of, printed

ALIKE = ["scene", "method", "seed"]


def lengths(rows: pd.DataFrame, name: str, steps: str, metric: str = "psnr", region: str = FULL) -> str:
    """A row a scene, one of their mean, a column a method: `before → after`, of the seeds that all lengths have.

    Args:
        rows: as `read_kept` gives them.
        steps: the lengths, `7000,30000`.
    """
    column = column_of(metric, region)
    parts = [KeptRuns.chosen(name, rows, {"steps": count}) for count in steps.split(",")]
    shared = set.intersection(*(set(part.rows[ALIKE].itertuples(index=False, name=None)) for part in parts))
    if not shared:
        raise NoRunsError(f"{name} has no run of one scene, method and seed with each of steps={steps}")
    same = [part.rows[[run in shared for run in part.rows[ALIKE].itertuples(index=False, name=None)]] for part in parts]
    runs = [KeptRuns(name, each) for each in same]
    places = places_of(runs[0].having(column))
    tables = [printed(each, column, places) for each in runs]
    methods = runs[0].methods
    lines = [
        [heading(place), *(" → ".join(table[method][row] for table in tables) for method in methods)]
        for row, place in enumerate(places)
    ]
    what = f"{column.axis[:1].upper()}{column.axis[1:]}, after fewer → after more steps of the same seed"
    heads = ["scene", *(f"`{method}`" for method in methods)]
    return f"{as_markdown(heads, lines)}\n{KeptRuns(name, pd.concat(same)).caption(what)}\n"
