"""Ledger: the outcomes of all jobs of one `envgs-bench run`, gathered from whatever process ran each, and printed."""

from __future__ import annotations

import json
import os
import uuid
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig
from rich.console import Console
from rich.table import Table

from envgs_bench.runs.outcome import Outcome

LEDGER_VARIABLE = "ENVGS_BENCH_LEDGER"


class Ledger(Callback):
    """Hydra callback: names the file that the jobs of this call append to. It lies in runs_dir, where all reach it."""

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        folder = Path(config.runs_dir).expanduser().absolute()
        os.environ[LEDGER_VARIABLE] = str(folder / f".outcomes-{uuid.uuid4().hex[:8]}.jsonl")

    on_multirun_start = on_run_start


def enter(outcome: Outcome) -> None:
    """Append `outcome` to the ledger of this call."""
    with open(os.environ[LEDGER_VARIABLE], "a", encoding="utf-8") as ledger:
        ledger.write(json.dumps(asdict(outcome)) + "\n")


def close_ledger() -> list[Outcome] | None:
    """All outcomes of this call so far, in the order in which they came, or None where no job was to run."""
    if LEDGER_VARIABLE not in os.environ:
        return None
    path = Path(os.environ.pop(LEDGER_VARIABLE))
    if not path.is_file():
        return []
    outcomes = [Outcome(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
    path.unlink()
    return outcomes


def print_outcomes(outcomes: list[Outcome], console: Console) -> None:
    """A table of the runs, and below it what is to be known of those that are not ok."""
    table = Table("dataset", "method", "seed", "status")
    for title in ("PSNR dB", "frame ms", "training s"):
        table.add_column(title, justify="right")
    table.add_column("run")
    for outcome in outcomes:
        numbers = (_cell(outcome.psnr, 2), _cell(outcome.frame_ms, 2), _cell(outcome.train_seconds, 1))
        table.add_row(outcome.dataset, outcome.method, str(outcome.seed), outcome.state, *numbers, outcome.run)
    console.print(table)
    for outcome in outcomes:
        if not outcome.ok:
            text = f"{outcome.name}: {outcome.message}\n  {outcome.folder}"
            console.print(text, soft_wrap=True, highlight=False, markup=False)


def _cell(number: float | None, digits: int) -> str:
    return "—" if number is None else f"{number:.{digits}f}"
