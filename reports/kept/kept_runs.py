"""KeptRuns: rows of kept runs that may share a table, their numbers, and the caption of where they come from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import pandas as pd

from ..numbers.cards import PLAIN
from ..numbers.comparison import Comparison, compare
from ..numbers.estimates import Numbers
from ..tables.columns import ENV_PRIMITIVES, FRAME_MS, NORMALS, PRIMITIVES, SCORES, TRAIN_SECONDS, Column, in_region
from .csv_file import NoRunsError
from .runs_file import FACTS

COSTS = (PRIMITIVES, ENV_PRIMITIVES, TRAIN_SECONDS, FRAME_MS)
COLUMNS = {column.metric: column for column in (*SCORES, NORMALS, *COSTS)}
FULL = "full"
HAVE_REGIONS = (*PLAIN, NORMALS.metric)  # the scores that rows have inside regions too


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
    def tidy(self) -> pd.DataFrame:
        """Every number of every run that ended well: dataset, method, seed, metric, region, value."""
        done = self.rows[self.rows["status"] == "ok"]
        present = [name for name in done.columns if name not in FACTS]
        long = done.melt(["scene", "method", "seed"], present, "column", "value").rename(columns={"scene": "dataset"})
        split = {name: _metric_and_region(name) for name in present}
        long["metric"] = long["column"].map(lambda name: split[name][0])
        long["region"] = long["column"].map(lambda name: split[name][1])
        return long.dropna(subset=["value"])

    @cached_property
    def numbers(self) -> Numbers:
        """Every score of every run, ready to be averaged.

        Raises:
            TableError: a seed is there twice, on two devices: a mean would count it twice.
        """
        twice = self.rows[self.rows.duplicated(["scene", "method", "steps", "seed"])]
        if len(twice):
            row = twice.iloc[0]
            raise TableError(
                f"{self.name} has seed {row['seed']} of {row['method']} on {row['scene']} twice, of several devices, "
                f"{row['device']} among them: choose with device=, or take rows out of the file"
            )
        return Numbers(self.tidy, self.rows.rename(columns={"scene": "dataset"}))

    def compared(self, column: Column, method: str, other: str, scenes: Sequence[str]) -> Comparison:
        """The method against the other on the scenes, paired by seed."""
        sign = 1 if column.better == "higher" else -1
        return compare(self.numbers, tuple(scenes), method, other, column.metric, column.region, sign)

    def having(self, column: Column) -> tuple[str, ...]:
        """The scenes on which some method has the number.

        Raises:
            TableError: on none; the message names what there is.
        """
        found = tuple(
            scene
            for scene in self.scenes
            if any(
                self.numbers.estimate((scene,), method, column.region, column.metric).mean is not None
                for method in self.methods
            )
        )
        if not found:
            raise TableError(self._without(column))
        return found

    def _without(self, column: Column) -> str:
        """That no row has the number, and in which regions the metric is, or else which metrics there are."""
        regions = sorted(self.tidy.loc[self.tidy["metric"] == column.metric, "region"].unique())
        if regions:
            return f"{self.name} has no {column.metric} of region={column.region} here, but of {', '.join(regions)}"
        metrics = [metric for metric in COLUMNS if metric in set(self.tidy["metric"])]
        return f"{self.name} has no {column.metric} here, but {', '.join(metrics) or 'no other metric either'}"

    def caption(self, what: str) -> str:
        """Where the numbers come from: what they are, seeds, steps, views, device, commit and file."""
        first = self.rows.iloc[0]
        lengths = sorted(map(int, self.rows["steps"].unique()))
        steps = " and ".join(f"{count:,}" for count in lengths) + " steps"
        views = f"{first['split']} views"
        where = f"{steps}, {views}" if len(lengths) == 1 else f"{steps}. {views.capitalize()}"
        seeds = sorted(map(int, self.rows["seed"].unique()))
        without_gap = len(seeds) > 2 and seeds[-1] - seeds[0] == len(seeds) - 1
        listed = f"{seeds[0]} to {seeds[-1]}" if without_gap else ", ".join(map(str, seeds))
        named = f"seed{'s' * (len(seeds) > 1)} {listed}"
        commits = ", ".join(f"`{commit}`" for commit in sorted(self.rows["commit"].unique()))
        devices = ", ".join(sorted(self.rows["device"].unique()))
        origin = f"protocol `{first['protocol']}`, {named}; {devices}, commit {commits}"
        return f"*{what}. {where}, {origin}. Source: `{self.name}`.*"


def column_of(metric: str, region: str = FULL) -> Column:
    """A column by its metric's name. Raises TableError for a metric that there is not."""
    if metric not in COLUMNS:
        raise TableError(f"there is no metric {metric!r}, but {', '.join(COLUMNS)}")
    column = COLUMNS[metric]
    return column if region == FULL else in_region(column, region)


def _metric_and_region(name: str) -> tuple[str, str]:
    """Of a column's name: psnr_near_field is psnr, near_field; what is no score in a region is itself."""
    for metric in HAVE_REGIONS:
        if name.startswith(f"{metric}_"):
            return metric, name.removeprefix(f"{metric}_")
    return name, FULL
