"""Plan: what a call of `envgs-bench run` would do, without doing it."""

from __future__ import annotations

import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from envgs_bench.captures import Capture, told_apart
from envgs_bench.plain_text import plain
from envgs_bench.run_folder import SNAPSHOT_NAME
from envgs_bench.run_lock import holder_of
from envgs_bench.runs.estimates import Estimates, duration
from envgs_bench.runs.identity import data_hash
from envgs_bench.runs.job import earlier_outcome
from envgs_bench.settings import RunSettings


class Plan:
    """The jobs of a call: each one's run, whether it is done, and how long it may take."""

    def __init__(self) -> None:
        self._captures: list[Capture] = []
        self._rows: list[tuple[str, ...]] = []  # without the data set
        self._estimates: Estimates | None = None
        self._done = self._left = self._unknown = 0
        self._seconds = 0.0

    def add(self, settings: RunSettings, folder: Path) -> None:
        """One more job, with its run's folder."""
        self._estimates = self._estimates or Estimates(settings.runs_dir)
        earlier = earlier_outcome(folder, settings)
        about = ""
        if earlier is not None:
            happens = earlier.state
            self._done += 1
        elif (holder := holder_of(folder)) is not None:
            happens = f"{holder} is running it"
            self._done += 1
        else:
            goes_on = (folder / SNAPSHOT_NAME).is_file() and not settings.force
            happens = "goes on from its snapshot" if goes_on else "runs"
            seconds = self._estimates.seconds(settings)
            self._left += 1
            self._unknown += seconds is None
            self._seconds += seconds or 0.0
            about = "" if seconds is None else duration(seconds)
        self._captures.append(
            Capture(settings.dataset_name, str(settings.dataset.get("root") or ""), data_hash(settings))
        )
        names = (settings.method_name, str(settings.seed), str(settings.steps))
        self._rows.append((*names, happens, about, folder.name.rpartition("-")[2]))

    def print(self) -> None:
        console = Console(width=None if sys.stdout.isatty() else 160)
        table = Table("dataset", "method", "seed", "steps", "what happens", "about", "run")
        for name, row in zip(told_apart(self._captures), self._rows, strict=True):
            table.add_row(*(Text(plain(cell)) for cell in (name, *row)))
        console.print(table)
        known = f", about {duration(self._seconds)} one after the other" if self._left > self._unknown else ""
        unknown = f"; of {self._unknown} no finished run tells how long they take" if self._unknown else ""
        console.print(f"{self._left} to run{known}{unknown}; {self._done} not to run", highlight=False)
