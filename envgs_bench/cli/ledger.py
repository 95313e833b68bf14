"""Ledger: the outcomes of all jobs of one `envgs-bench run`, gathered from whatever process ran each, and printed."""

from __future__ import annotations

import json
import os
import uuid
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig
from rich.console import Console
from rich.table import Table
from rich.text import Text

from envgs_bench.runs.interruption import INTERRUPTION
from envgs_bench.runs.outcome import Outcome
from envgs_bench.runs.output import plain

LEDGER_VARIABLE = "ENVGS_BENCH_LEDGER"
SWEEP_VARIABLE = "ENVGS_BENCH_SWEEP"  # the number of the process that `envgs-bench run` was called in
_unwritten: list[Outcome] = []  # of this process, where the ledger's disk is full


class Ledger(Callback):
    """Hydra callback: names the file that the jobs of this call append to. It lies in runs_dir, where all reach it."""

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        folder = Path(config.runs_dir).expanduser().absolute()
        os.environ[LEDGER_VARIABLE] = str(folder / f".outcomes-{uuid.uuid4().hex[:8]}.jsonl")

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        self.on_run_start(config)
        if not runs_here(config):
            INTERRUPTION.lead(stop_file())


def runs_here(config: DictConfig) -> bool:
    """Whether the sweep's own process runs its jobs, one after the other, and not those of a launcher."""
    return config.hydra.launcher._target_.endswith("BasicLauncher")


def enter(outcome: Outcome) -> None:
    """Append `outcome` to the ledger of this call."""
    try:
        with open(os.environ[LEDGER_VARIABLE], "a", encoding="utf-8") as ledger:
            ledger.write(json.dumps(asdict(outcome)) + "\n")
    except OSError:
        _unwritten.append(outcome)


def stop_file() -> Path:
    """The file that is there when the jobs of this call are to end."""
    return Path(os.environ[LEDGER_VARIABLE]).with_suffix(".stop")


def close_ledger() -> list[Outcome] | None:
    """All outcomes of this call so far, in the order in which they came, or None where no job was to run."""
    if LEDGER_VARIABLE not in os.environ:
        return None
    stop_file().unlink(missing_ok=True)
    path = Path(os.environ.pop(LEDGER_VARIABLE))
    outcomes = []
    if path.is_file():
        for line in path.read_text(encoding="utf-8").splitlines():
            with suppress(ValueError, TypeError):  # the disk was full in the middle of it
                outcomes.append(Outcome(**json.loads(line)))
        path.unlink()
    outcomes += _unwritten
    _unwritten.clear()
    return outcomes


def print_outcomes(outcomes: list[Outcome], console: Console) -> None:
    """A table of the runs, and below it what is to be known of some."""
    table = Table("dataset", "method", "seed", "status")
    for title in ("PSNR dB", "frame ms", "training s"):
        table.add_column(title, justify="right")
    table.add_column("run")
    for outcome in outcomes:
        numbers = (_cell(outcome.psnr, 2), _cell(outcome.frame_ms, 2), _cell(outcome.train_seconds, 1))
        cells = (outcome.dataset, outcome.method, str(outcome.seed), outcome.state, *numbers, outcome.run)
        table.add_row(*(Text(plain(cell)) for cell in cells))
    console.print(table)
    for outcome in outcomes:
        if outcome.message:
            text = f"{outcome.name}: {outcome.message}\n  {outcome.folder}"
            console.print(plain(text), soft_wrap=True, highlight=False, markup=False)


def _cell(number: float | None, digits: int) -> str:
    return "—" if number is None else f"{number:.{digits}f}"
