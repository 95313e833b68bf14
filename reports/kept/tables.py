"""Tables of a page, from rows of kept runs: scores, differences, costs, and the caption of where they come from."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import pandas as pd

from ..numbers.cards import PLAIN
from ..numbers.comparison import Comparison, compare
from ..numbers.estimates import Estimate, Numbers
from ..tables.columns import (
    AGREEMENT,
    ENV_PRIMITIVES,
    FRAME_MS,
    NORMALS,
    OWN_SECONDS,
    PRIMITIVES,
    SCORES,
    TRAIN_SECONDS,
    Column,
    in_region,
)
from .runs_file import FACTS, NoRunsError

COSTS = (PRIMITIVES, ENV_PRIMITIVES, TRAIN_SECONDS, FRAME_MS)
COLUMNS = {column.metric: column for column in (*SCORES, NORMALS, *COSTS)}
FULL = "full"
NOTHING = "–"
MOST_COLUMNS = 6  # of means and deviations, that a page shows without scrolling
PageTable = Callable[..., str]  # of KeptRuns and what else a comment says, by name -> Markdown


class TableError(ValueError):
    """A table that cannot be made; the message says what was asked and what there is."""


@dataclass(frozen=True)
class KeptRuns:
    """Rows of one file that may share a table: of test or of validation views, of one number of steps or of lengths.

    Attributes:
        name: of the file, for the caption.
        rows: as `read_kept` gives them.
    """

    name: str
    rows: pd.DataFrame

    @classmethod
    def chosen(cls, name: str, rows: pd.DataFrame, wanted: Mapping[str, str]) -> KeptRuns:
        """Those rows whose steps, split, protocol, scene and method are among the wanted ones (`a,b`).

        Raises:
            NoRunsError: none is left.
            TableError: what is left has several steps, splits or protocols.
        """
        for key, values in wanted.items():
            rows = rows[rows[key].astype(str).isin(values.split(","))]
            if rows.empty:
                raise NoRunsError(f"{name} has no run with {key}={values}")
        runs = cls(name, rows)
        for key in ("steps", "split", "protocol"):
            runs.of_one(key)
        return runs

    def of_one(self, key: str) -> None:
        """Raises TableError where the rows differ in this fact."""
        found = sorted(map(str, self.rows[key].unique()))
        if len(found) > 1:
            raise TableError(f"{self.name} has runs of several {key} here, {', '.join(found)}: choose with {key}=")

    @cached_property
    def methods(self) -> tuple[str, ...]:
        """By their cards' order."""
        ordered = self.rows.sort_values(["order", "method"], kind="stable")
        return tuple(ordered["method"].unique())

    @cached_property
    def scenes(self) -> tuple[str, ...]:
        return tuple(sorted(self.rows["scene"].unique()))

    @cached_property
    def numbers(self) -> Numbers:
        """Every score of every run, ready to be averaged."""
        done = self.rows[self.rows["status"] == "ok"]
        present = [name for name in done.columns if name not in FACTS]
        long = done.melt(["scene", "method", "seed"], present, "column", "value").rename(columns={"scene": "dataset"})
        split = {name: _metric_and_region(name) for name in present}
        long["metric"] = long["column"].map(lambda name: split[name][0])
        long["region"] = long["column"].map(lambda name: split[name][1])
        return Numbers(long.dropna(subset=["value"]), self.rows.rename(columns={"scene": "dataset"}))

    def compared(self, column: Column, method: str, other: str, scenes: Sequence[str]) -> Comparison:
        """The method against the other on the scenes, paired by seed."""
        sign = 1 if column.better == "higher" else -1
        return compare(self.numbers, tuple(scenes), method, other, column.metric, column.region, sign)

    def having(self, column: Column) -> tuple[str, ...]:
        """The scenes on which some method has the number."""
        return tuple(
            scene
            for scene in self.scenes
            if any(
                self.numbers.estimate((scene,), method, column.region, column.metric).mean is not None
                for method in self.methods
            )
        )

    def caption(self, what: str) -> str:
        """Where the numbers come from: what they are, seeds, steps, views, device, commit and file."""
        first = self.rows.iloc[0]
        steps = " and ".join(f"{count:,}" for count in sorted(map(int, self.rows["steps"].unique())))
        seeds = sorted(map(int, self.rows["seed"].unique()))
        without_gap = len(seeds) > 2 and seeds[-1] - seeds[0] == len(seeds) - 1
        listed = f"{seeds[0]} to {seeds[-1]}" if without_gap else ", ".join(map(str, seeds))
        named = f"seed{'s' * (len(seeds) > 1)} {listed}"
        commits = ", ".join(f"`{commit}`" for commit in sorted(self.rows["commit"].unique()))
        devices = ", ".join(sorted(self.rows["device"].unique()))
        return (
            f"*{what}. {steps} steps, {first['split']} views, protocol `{first['protocol']}`, "
            f"{named}; {devices}, commit {commits}. Source: `{self.name}`.*"
        )


def column_of(metric: str, region: str = FULL) -> Column:
    """A column by its metric's name. Raises TableError for a metric that there is not."""
    if metric not in COLUMNS:
        raise TableError(f"there is no metric {metric!r}, but {', '.join(COLUMNS)}")
    column = COLUMNS[metric]
    return column if region == FULL else in_region(column, region)


def places_of(scenes: tuple[str, ...]) -> list[tuple[str, ...]]:
    """What a column is of: each scene, and all of them where there are several."""
    return [*((scene,) for scene in scenes), *([scenes] if len(scenes) > 1 else [])]


def heading(place: tuple[str, ...]) -> str:
    return f"`{place[0].rpartition('/')[2]}`" if len(place) == 1 else "mean"


def scores(runs: KeptRuns, metric: str = "psnr", region: str = FULL) -> str:
    """A row a method, a column a scene and their mean, or the other way where these are too many to stand in a row.

    The best of each scene is bold.
    """
    column = column_of(metric, region)
    places = places_of(runs.having(column))
    table = arranged(places, printed(runs, column, places), down=len(places) > MOST_COLUMNS)
    what = capital(column.axis)
    if runs.rows["seed"].nunique() > 1:
        what += ", mean over seeds ± their standard deviation"
    return f"{table}\n{runs.caption(what)}\n"


def arranged(places: Sequence[tuple[str, ...]], cells: Mapping[str, Sequence[str]], *, down: bool) -> str:
    """Each method's cells of the places: a row a method, or a row a place where these go down."""
    heads = ["scene" if down else "method", *(heading(place) for place in places)]
    lines = [heads, *([f"`{method}`", *own] for method, own in cells.items())]
    head, *rows = [list(line) for line in zip(*lines, strict=True)] if down else lines
    return as_markdown(head, rows)


def capital(words: str) -> str:
    """Words that begin a caption."""
    return words[:1].upper() + words[1:]


def printed(runs: KeptRuns, column: Column, places: Sequence[tuple[str, ...]]) -> dict[str, list[str]]:
    """Method -> its cell of each place; the best of each place is bold."""
    cells: dict[str, list[str]] = {method: [] for method in runs.methods}
    for place in places:
        found = {each: runs.numbers.estimate(place, each, column.region, column.metric) for each in runs.methods}
        values = {each: column.printed(cell.mean) for each, cell in found.items() if cell.mean and cell.complete}
        best = (max if column.better == "higher" else min)(values.values(), default=None)
        for method, cell in found.items():
            cells[method].append(_cell(column, cell, values.get(method) == best and column.ranked))
    return cells


def gains(runs: KeptRuns, of: str, metric: str = "psnr", region: str = FULL) -> str:
    """A row each other method: how far `of` is ahead of it on each scene and on average, with 95 % intervals."""
    column = column_of(metric, region)
    if of not in runs.methods:
        raise TableError(f"{runs.name} has no method {of!r} here, but {', '.join(runs.methods)}")
    places = places_of(runs.having(column))
    rows = [
        [f"`{other}`", *(difference(column, runs.compared(column, of, other, place)) for place in places)]
        for other in runs.methods
        if other != of
    ]
    heads = [heading(place) for place in places]
    what = f"{capital(column.axis)}, of `{of}` less the row's method, paired by seed"
    what += "; brackets are 95 % intervals, bold where they exclude 0"
    return f"{as_markdown([f'`{of}` less', *heads], rows)}\n{runs.caption(what)}\n"


def difference(column: Column, found: Comparison) -> str:
    """A difference and its interval, bold where it is decided."""
    if found.difference.mean is None:
        return NOTHING
    mean = column.signed(found.difference.mean)
    if found.difference.interval is None:
        return mean
    ends = ", ".join(column.signed(end) for end in found.difference.interval)
    return f"**{mean}** [{ends}]" if found.better() or found.worse() else f"{mean} [{ends}]"


def costs(runs: KeptRuns) -> str:
    """A row a method: PSNR and what a picture costs, as means over the scenes, timed on one device."""
    runs.of_one("device")
    columns = [column_of("psnr"), *COSTS]
    rows = [
        [
            f"`{method}`",
            *(_cell(column, runs.numbers.estimate(runs.scenes, method, FULL, column.metric)) for column in columns),
        ]
        for method in runs.methods
    ]
    heads = [column.title for column in columns]
    return f"{as_markdown(['method', *heads], rows)}\n{runs.caption('Means over scenes')}\n"


def programs(runs: KeptRuns) -> str:
    """A row a method and device on one scene: scores, what it costs, and how a program's pictures agree."""
    runs.of_one("scene")
    costs = (PRIMITIVES, TRAIN_SECONDS, OWN_SECONDS, FRAME_MS, AGREEMENT)
    columns = [*SCORES, *costs]
    rows = []
    for method in runs.methods:
        for device, its in runs.rows[runs.rows["method"] == method].groupby("device"):
            numbers = KeptRuns(runs.name, its).numbers
            cells = (_cell(column, numbers.estimate(runs.scenes, method, FULL, column.metric)) for column in columns)
            rows.append([f"`{method}`", str(device), *cells])
    first = runs.rows.iloc[0]
    what = f"`{first['scene']}`, {first['width']}×{first['height']} pixels"
    heads = ["method", "on", *(column.title for column in columns)]
    return f"{as_markdown(heads, rows)}\n{runs.caption(what)}\n"


def _cell(column: Column, found: Estimate, best: bool = False) -> str:
    """A mean with its spread over seeds, and how many runs finished where not all did."""
    if found.averaged and not found.complete:
        return f"{NOTHING} ({found.done}/{found.expected})"
    if found.mean is None:
        return NOTHING
    text = f"**{column.unsigned(found.mean)}**" if best else column.unsigned(found.mean)
    if found.spread is not None and column.ranked:
        text = f"{text} ± {column.unsigned(found.spread)}"
    return text if found.done == found.expected else f"{text} ({found.done}/{found.expected})"


def _metric_and_region(name: str) -> tuple[str, str]:
    """Of a column's name: psnr_near_field is psnr, near_field; what is no score in a region is itself."""
    metric, _, region = name.partition("_")
    return (metric, region) if metric in PLAIN and region else (name, FULL)


def as_markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table whose first column is of words."""
    lines = [heads, [":--", *["--:"] * (len(heads) - 1)], *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
