"""How long what is waited for takes, beside what is wanted, from a CSV of times measured alone on a GPU."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from .csv_file import read_rows
from .runs_file import RunsFileError
from .tables import NOTHING, as_markdown

FACTS = ("what", "primitives", "size", "measured", "wanted", "unit", "device", "commit")


def read_speed(path: Path) -> pd.DataFrame:
    """The rows of a file of times: `measured` is a time, `wanted` the longest that is good enough or empty.

    Raises:
        NoRunsError: there is no such file.
        RunsFileError: it is another.
    """
    rows = read_rows(path, FACTS, RunsFileError, "times", "envgs-bench bench core --json FILE", as_text=True)
    try:
        return rows.assign(**{name: pd.to_numeric(rows[name]) for name in ("measured", "wanted")})
    except ValueError as wrong:
        raise RunsFileError(f"{path}: measured and wanted are numbers, or wanted is empty: {wrong}") from wrong


def speed(rows: pd.DataFrame, name: str) -> str:
    """A row a time, those first that miss what is wanted by most, then those that do not, then those without a goal."""
    rows = rows.assign(ratio=rows["measured"] / rows["wanted"])
    lines = []
    for _, row in rows.sort_values("ratio", ascending=False, kind="stable").iterrows():
        measured, wanted = (_time(row[column], row["unit"]) for column in ("measured", "wanted"))
        missed = ", missed" if row["ratio"] > 1 else ""
        lines.append([row["what"], row["size"], row["primitives"], measured + missed, wanted])
    heads = ["what takes time", "pixels", "primitives", "measured", "wanted, at most"]
    commits = rows.groupby("device")["commit"].unique()  # by the devices' order
    places = "; ".join(
        f"{device}, commit {', '.join(f'`{one}`' for one in sorted(own))}" for device, own in commits.items()
    )
    return f"{as_markdown(heads, lines)}\n*{places}, nothing else on that GPU. Source: `{name}`.*\n"


def _time(value: float, unit: str) -> str:
    return NOTHING if pd.isna(value) else f"{value:.3g} {unit}"
