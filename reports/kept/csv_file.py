"""A CSV of kept rows: read, or a message that says what is wrong with it, and written."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from envgs_bench.records import write_atomically


class NoRunsError(ValueError):
    """Runs that were never kept; the message says which."""


def read_rows(
    path: Path, columns: Sequence[str], error: type[ValueError], what: str, made_by: str, *, as_text: bool = False
) -> pd.DataFrame:
    """The file's rows; an empty cell is an empty text.

    Args:
        columns: what it must have.
        error: what is raised of another file.
        what: the rows, in the plural.
        made_by: the command that writes such a file.
        as_text: whether no value is read as a number.

    Raises:
        NoRunsError: there is no such file.
    """
    if not path.exists():
        raise NoRunsError(f"there is no {path.parent.name}/{path.name}")
    try:
        rows = pd.read_csv(path, dtype=str if as_text else None, keep_default_na=False)
    except (OSError, ValueError) as wrong:
        raise error(f"{path}: cannot be read: {wrong}") from wrong
    if absent := [name for name in columns if name not in rows]:
        raise error(
            f"{path}: expected a CSV of {what} with the columns {', '.join(columns)}; it has no {absent[0]}. "
            f"Make one with `{made_by}`"
        )
    return rows


def write_rows(path: Path, columns: Sequence[str], rows: Iterable[Mapping[Any, Any]]) -> None:
    """The file with these rows and no other; a cell that a row has not is empty."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(path, text.getvalue())
