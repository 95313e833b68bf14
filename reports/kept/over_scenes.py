"""A table of a page over many scenes: how far a method is ahead of each other one, and on which share of the scenes."""

from __future__ import annotations

import numpy as np

from ..numbers.intervals import mean_interval, sample_interval, share_interval
from ..tables.columns import Column
from .kept_runs import FULL, KeptRuns, TableError, column_of
from .tables import NOTHING, as_markdown, capital

LEVEL_DB = 0.1  # behind by no more is level
MANY = 12  # scenes, of which a bootstrap holds what it says
HEADS = ("scenes", "mean", "ahead on", f"behind by {LEVEL_DB} dB at most on", "worst", "failed runs")


def over_scenes(runs: KeptRuns, of: str, region: str = FULL) -> str:
    """A row each other method: `of` less it in PSNR, dB. A scene counts once, as the mean of its seeds."""
    column = column_of("psnr", region)
    runs.having(column)
    rows = []
    for other in runs.methods:
        if other != of:
            gained = differences(runs, of, other, column)
            rows.append([f"`{other}`", str(len(gained)), *_cells(gained, column), str(_failed(runs, other))])
    what = f"{capital(column.axis)}, of `{of}` less the row's method; a scene counts once. "
    what += f"Brackets are 95 % intervals over scenes. Failed runs of `{of}`: {_failed(runs, of)}"
    return f"{as_markdown([f'`{of}` less', *HEADS], rows)}\n{runs.caption(what)}\n"


def differences(runs: KeptRuns, of: str, less: str, column: Column) -> np.ndarray:
    """[N] scores of a method less another's, of the scenes that both finished.

    Raises:
        TableError: the runs have no such score, or not of one of the two.
    """
    done = runs.rows[runs.rows["status"] == "ok"]
    name = column.metric if column.region == FULL else f"{column.metric}_{column.region}"
    missing = [method for method in (of, less) if method not in runs.methods]
    if missing or name not in done:
        raise TableError(f"{runs.name} has no {name} of {(missing or [of])[0]!r} here; methods: {runs.methods}")
    table = done.pivot_table(index="scene", columns="method", values=name, aggfunc="mean")
    return (table[of] - table[less]).dropna().to_numpy() if {of, less} <= set(table) else np.zeros(0)


def mean_over_scenes(gained: np.ndarray, column: Column) -> str:
    """The mean and its interval over scenes, as pages have them: Student's of few scenes, by bootstrap of many."""
    if not len(gained):
        return NOTHING
    interval = sample_interval(gained) if len(gained) >= MANY else mean_interval([gained])
    mean, ends = column.signed(gained.mean()), [column.signed(end) for end in interval or ()]
    return f"{mean} [{', '.join(ends)}]" if ends else mean


def _failed(runs: KeptRuns, method: str) -> int:
    return int((runs.rows.loc[runs.rows["method"] == method, "status"] != "ok").sum())


def _cells(gained: np.ndarray, column: Column) -> list[str]:
    """Of differences, dB: their mean, the share that is positive, the share that is level or positive, the worst."""
    if not len(gained):
        return [NOTHING] * 4
    shares = [_share(int((gained > least).sum()), len(gained)) for least in (0.0, -LEVEL_DB)]
    return [mean_over_scenes(gained, column), *shares, column.signed(gained.min())]


def _share(hits: int, count: int) -> str:
    low, high = share_interval(hits, count)
    return f"{100 * hits / count:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"
