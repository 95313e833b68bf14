"""A Markdown page whose tables and sentences are filled from files of kept runs.

A table stands between two comments, of which the first says what it shows:

    <!-- table: gains of=envgs records=photographs.csv steps=7000 metric=psnr -->
    <!-- end of table -->

and a number in a sentence likewise, `<!-- number: of=envgs less=2dgs_tuned records=… -->+0.3<!-- end -->`; its interval
is over seeds, and with over=scenes over scenes.
Where no such runs are kept, the page says so in the place of the table or number.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from .kept.counts import false_alarms, found, read_counts
from .kept.csv_file import NoRunsError
from .kept.kept_runs import FULL, KeptRuns, TableError, column_of
from .kept.lengths import lengths
from .kept.originals import BESIDE_ORIGINALS, MarksError, read_marks, read_words
from .kept.over_scenes import differences, mean_over_scenes, over_scenes
from .kept.perturbed_file import read_perturbed
from .kept.perturbed_tables import lag, recall, stability
from .kept.runs_file import read_kept
from .kept.speed import read_speed, speed
from .kept.tables import NOTHING, PageTable, costs, difference, gains, programs, scores
from .studies import STUDIES

TABLE = re.compile(r"(<!-- table: (\w+) (.*?) -->\n).*?(<!-- end of table -->)", re.DOTALL)
NUMBER = re.compile(r"(<!-- number: (.*?) -->).*?(<!-- end -->)", re.DOTALL)
CHOICES = ("scene", "method", "steps", "split", "protocol", "device")
KINDS: dict[str, PageTable] = {each.__name__: each for each in (scores, gains, costs, over_scenes, programs)}
OF_OTHERS: dict[str, tuple[Callable[[Path], pd.DataFrame], Callable[..., str]]] = {  # of other files: how they are read
    **{table.__name__: (read_counts, table) for table in (false_alarms, found)},
    **{table.__name__: (read_perturbed, table) for table in (recall, lag, stability)},
    speed.__name__: (read_speed, speed),
    lengths.__name__: (read_kept, lengths),  # of several numbers of steps
}


def fill_page(page: Path, folder: Path) -> tuple[str, list[str]]:
    """The page's text with every table and number made anew from the files in the folder, and what no run is kept of.

    Raises:
        TableError: a comment asks for what is not there; the message names the page and the comment.
        RunsFileError: a file that a comment names cannot be used.
    """
    text = page.read_text(encoding="utf-8")
    absent: list[str] = []

    def explained(asked: str, make: Callable[[], str], instead: str) -> str:
        try:
            return make()
        except NoRunsError as error:
            absent.append(f"{asked}: {error}")
            return instead.format(error)
        except TableError as error:
            raise TableError(f"{page}: {asked}: {error}") from None

    def table(found: re.Match[str]) -> str:
        head, kind, asked, end = found.groups()
        made = explained(f"{kind} {asked}", lambda: _table(kind, asked, folder), "*Not measured: {}.*\n")
        return f"{head}\n{made}\n{end}"

    def number(found: re.Match[str]) -> str:
        head, asked, end = found.groups()
        return f"{head}{explained(asked, lambda: _number(asked, folder), '(not measured)')}{end}"

    return NUMBER.sub(number, TABLE.sub(table, text)), absent


def _table(kind: str, asked: str, folder: Path) -> str:
    of_runs = KINDS | {name: make for study in STUDIES for name, make in study.page_tables.items()}
    if kind in BESIDE_ORIGINALS:
        return _beside_originals(kind, asked, folder)
    if kind not in {*of_runs, *OF_OTHERS}:
        raise TableError(f"there is no table {kind!r}, but {', '.join((*of_runs, *OF_OTHERS, *BESIDE_ORIGINALS))}")
    try:
        if kind in of_runs:
            runs, rest = _chosen(asked, folder)
            return of_runs[kind](runs, **rest)
        name, rest = _named(asked)
        read, table = OF_OTHERS[kind]
        return table(read(folder / name), f"{folder.name}/{name}", **rest)
    except TypeError as error:
        raise TableError(f"{kind} cannot be asked so: {error}") from None


def _beside_originals(kind: str, asked: str, folder: Path) -> str:
    files = dict(word.partition("=")[::2] for word in asked.split())
    if set(files) != {"records", "words"}:
        raise TableError(
            "say records=<file>, a CSV of marks, and words=<file>, a CSV of what differs, and nothing else"
        )
    try:
        return BESIDE_ORIGINALS[kind](read_marks(folder / files["records"]), read_words(folder / files["words"]))
    except MarksError as error:
        raise TableError(str(error)) from error


def _number(asked: str, folder: Path) -> str:
    runs, rest = _chosen(asked, folder)
    region = rest.get("region", FULL)
    column = column_of(rest.get("metric", "psnr"), region)
    if missing := [key for key in ("of", "less") if key not in rest]:
        raise TableError(f"say {missing[0]}=<method>")
    of, less, having = rest["of"], rest["less"], runs.having(column)
    if rest.get("over") == "scenes":
        text = mean_over_scenes(differences(runs, of, less, column), column)
    else:
        text = difference(column, runs.compared(column, of, less, having)).replace("*", "")
    if text == NOTHING:
        raise TableError(
            f"{runs.name}: no scene has {column.metric} of region={region} of both {of!r} and {less!r} here"
        )
    return text


def _chosen(asked: str, folder: Path) -> tuple[KeptRuns, dict[str, str]]:
    """The rows that a comment asks for, of one file or of several as `a,b`, and what else it says."""
    named, pairs = _named(asked)
    names = named.split(",")
    wanted = {key: pairs.pop(key) for key in CHOICES if key in pairs}
    rows = pd.concat([read_kept(folder / name) for name in names], ignore_index=True)
    return KeptRuns.chosen(", ".join(f"{folder.name}/{name}" for name in names), rows, wanted), pairs


def _named(asked: str) -> tuple[str, dict[str, str]]:
    """The file that a comment names, and what else it says."""
    pairs = dict(word.partition("=")[::2] for word in asked.split())
    if "records" not in pairs:
        raise TableError("say records=<file>, a CSV of kept runs")
    return pairs.pop("records"), pairs
