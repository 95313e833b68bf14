"""Sweep summary: the outcomes of all jobs of one `envgs-bench run`, gathered from the processes that ran them."""

from __future__ import annotations

import json
import math
import os
import shlex
import sys
import time
import uuid
from collections import Counter
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.experimental.callback import Callback
from omegaconf import DictConfig
from rich.console import Console
from rich.table import Table
from rich.text import Text

from envgs_bench.captures import Capture, told_apart
from envgs_bench.pages import help_on
from envgs_bench.plain_text import plain
from envgs_bench.runs.estimates import duration
from envgs_bench.runs.interruption import INTERRUPTION
from envgs_bench.runs.outcome import Outcome

from .explained import lies_at
from .live_page import begin_page

SUMMARY_VARIABLE = "ENVGS_BENCH_SWEEP_SUMMARY"
SWEEP_VARIABLE = "ENVGS_BENCH_SWEEP"  # JSON: `Sweep`
_unwritten: list[Outcome] = []  # of this process, where the summary's disk is full


@dataclass(frozen=True)
class Sweep:
    """One call of `envgs-bench run`, as all processes that run its jobs know it."""

    pid: int  # of the process it was called in
    began: float  # Unix time
    jobs: int | None = None  # how many there are, None where that is not known

    @classmethod
    def current(cls) -> Sweep:
        return cls(**json.loads(os.environ[SWEEP_VARIABLE]))

    def announce(self) -> None:
        """Tell this process, and those that it starts from now on."""
        os.environ[SWEEP_VARIABLE] = json.dumps(asdict(self))


class SweepSummary(Callback):
    """Hydra callback: names the file that the jobs of this call append to. It lies in runs_dir, where all reach it."""

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        folder = Path(config.runs_dir).expanduser().absolute()
        os.environ[SUMMARY_VARIABLE] = str(folder / f".outcomes-{uuid.uuid4().hex[:8]}.jsonl")
        if config.page:
            begin_page(Path(config.page).expanduser().absolute())

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        self.on_run_start(config)
        replace(Sweep.current(), jobs=_jobs_of(config)).announce()
        if not runs_here(config):
            INTERRUPTION.lead(stop_file())


def runs_here(config: DictConfig) -> bool:
    """Whether the sweep's own process runs its jobs, one after the other, and not those of a launcher."""
    return config.hydra.launcher._target_.endswith("BasicLauncher")


def _jobs_of(config: DictConfig) -> int | None:
    """How many jobs a sweep has: the product of what it takes in turn, on the command line and in the experiment."""
    parser = OverridesParser.create()
    given = {key: f"{key}={value}" for key, value in (config.hydra.sweeper.get("params") or {}).items()}
    given |= {override.partition("=")[0]: override for override in config.hydra.overrides.task}
    try:
        overrides = parser.parse_overrides(list(given.values()))
        return math.prod(sum(1 for _ in one.sweep_string_iterator()) for one in overrides if one.is_sweep_override())
    except (HydraException, ValueError):
        return None  # as of a sweeper of somebody else's


def position(number: int) -> str:
    """Which job of how many the one with this number, from 0, is; "" of a single one."""
    jobs = Sweep.current().jobs
    return f"[{number + 1}/{jobs}] " if jobs and jobs > 1 else ""


def time_left() -> str:
    """How far the sweep has come and how long it may still take; "" where there is nothing to tell."""
    sweep, (done, ran) = Sweep.current(), _entered()
    if not sweep.jobs or sweep.jobs == done or not ran or INTERRUPTION.requested:
        return ""
    elapsed = time.time() - sweep.began
    left = f"{duration(elapsed / ran * (sweep.jobs - done))} left if the others take as long on average"
    return f"{done} of {sweep.jobs} jobs done in {duration(elapsed)}, {left}"


def under_way() -> str:
    """What the page of a sweep says of jobs that have not ended; "" where there are none, or nobody knows."""
    jobs, (done, _) = Sweep.current().jobs, _entered()
    return f"{done} of {jobs} runs have ended: this page fills as the others do." if jobs and done < jobs else ""


def _entered() -> tuple[int, int]:
    """How many jobs have ended, and how many of them ran; those that were interrupted have not."""
    path = Path(os.environ[SUMMARY_VARIABLE])
    # Counted, not parsed: this is asked after every job. Within a string, quotes are escaped.
    entered = path.read_bytes() if path.is_file() else b""
    interrupted = entered.count(b'"status": "interrupted", "action": "ran"')
    return entered.count(b"\n") - interrupted, entered.count(b'"action": "ran"') - interrupted


def shown_runs_dir() -> str:
    """The runs_dir of this call, as short as it can be said from here; "" where no job was to run."""
    folder = Path(os.environ.get(SUMMARY_VARIABLE, "")).parent
    return str(folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder)


def enter(outcome: Outcome) -> None:
    """Append `outcome` to the summary of this call."""
    try:
        with open(os.environ[SUMMARY_VARIABLE], "a", encoding="utf-8") as summary:
            summary.write(json.dumps(asdict(outcome)) + "\n")
    except OSError:
        _unwritten.append(outcome)


def stop_file() -> Path:
    """The file that is there when the jobs of this call are to end."""
    return Path(os.environ[SUMMARY_VARIABLE]).with_suffix(".stop")


def of_runs_dir(error: OSError) -> bool:
    """Whether what could not be read or written lies in the runs_dir of this call, or is needed to make that folder."""
    return SUMMARY_VARIABLE in os.environ and lies_at(error, Path(os.environ[SUMMARY_VARIABLE]).parent)


def close_summary() -> list[Outcome] | None:
    """All outcomes of this call so far, in the order in which they came, or None where no job was to run."""
    if SUMMARY_VARIABLE not in os.environ:
        return None
    with suppress(OSError):
        stop_file().unlink()
    path = Path(os.environ.pop(SUMMARY_VARIABLE))
    outcomes = _read(path)
    with suppress(OSError):
        path.unlink()
    outcomes += _unwritten
    _unwritten.clear()
    return outcomes


def _read(path: Path) -> list[Outcome]:
    outcomes = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else []:
        with suppress(ValueError, TypeError):  # the disk was full in the middle of it
            outcomes.append(Outcome(**json.loads(line)))
    return outcomes


def print_outcomes(outcomes: list[Outcome], console: Console) -> None:
    """A table of the runs, and below it what is to be known of some."""
    table = Table("dataset", "method", "seed", "status")
    for title in ("PSNR dB", "frame ms", "training s"):
        table.add_column(title, justify="right")
    table.add_column("run")
    names = told_apart([Capture(outcome.dataset, outcome.root, outcome.data) for outcome in outcomes])
    for outcome, name in zip(outcomes, names, strict=True):
        numbers = (_cell(outcome.psnr, 2), _cell(outcome.frame_ms, 2), _cell(outcome.train_seconds, 1))
        cells = (name, outcome.method, str(outcome.seed), outcome.state, *numbers, outcome.run)
        table.add_row(*(Text(plain(cell)) for cell in cells))
    console.print(table)
    for outcome in outcomes:
        if outcome.message:
            error = outcome.message.partition(":")[0]
            text = f"{outcome.name}: {outcome.message}\n  {outcome.folder}\n  {help_on(error)}"
            console.print(plain(text), soft_wrap=True, highlight=False, markup=False)

    counts = Counter(key for outcome in outcomes for key in outcome.remarks)
    phrases = {key: phrase for outcome in reversed(outcomes) for key, phrase in outcome.remarks.items()}  # the first's
    for key, count in counts.items():
        text = f"{count} of {len(outcomes)} runs: {phrases[key]}"
        console.print(plain(text), soft_wrap=True, highlight=False, markup=False)


def print_next(runs_dir: str, page: Path | None) -> None:
    """The page of what there is now, or the command that makes one, with tables and charts."""
    line = page or shlex.join(["envgs-bench", "report", runs_dir])
    print(plain(f"tables, charts and a page: {line}"), file=sys.stderr)


def _cell(number: float | None, digits: int) -> str:
    return "—" if number is None else f"{number:.{digits}f}"
