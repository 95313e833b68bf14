"""Outcomes: what became of each job of one `envgs-bench run`, gathered from whatever process ran it."""

from __future__ import annotations

import json
import os
import uuid
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig
from rich.console import Console
from rich.table import Table

from envgs_bench.records import Record, RecordError, read_record
from envgs_bench.settings import RunSettings

LEDGER_VARIABLE = "ENVGS_BENCH_LEDGER"


@dataclass(frozen=True)
class Outcome:
    """One job. `action` is ran, reused, not retried, skipped (another process is at it) or unreadable."""

    dataset: str
    method: str
    seed: int
    status: str  # the record's; "" where there is none to read
    action: str
    message: str  # what the user should know or do, "" where all is well
    psnr: float | None
    frame_ms: float | None
    train_seconds: float | None
    folder: str

    @property
    def ok(self) -> bool:
        return self.status == "ok"

    @property
    def name(self) -> str:
        return f"{self.dataset} · {self.method} · seed {self.seed}"

    @property
    def run(self) -> str:
        """The hash in the folder's name, which tells runs of one method apart."""
        return self.folder.rpartition("-")[2]

    @property
    def state(self) -> str:
        """The status, with what was done where it was not to run."""
        return self.status if self.action == "ran" else f"{self.status} ({self.action})".strip()

    def __str__(self) -> str:
        return f"{self.name}: {self.state}, {self.folder}"


def outcome_of(folder: Path, settings: RunSettings, action: str, message: str = "") -> Outcome:
    """The outcome that the record in `folder` tells."""
    record: Record | None
    try:
        record = read_record(folder)
    except RecordError:
        record = None
    if record and record.error:
        message = f"{record.error.type}: {record.error.message}" + (f" ({message})" if message else "")
    return Outcome(
        dataset=record.dataset if record else settings.dataset_name,
        method=settings.method_name,
        seed=settings.seed,
        status=record.status if record else "",
        action=action,
        message=message,
        psnr=record.metrics.mean.get("psnr") if record and record.metrics else None,
        frame_ms=record.timing.frame_ms if record and record.timing else None,
        train_seconds=record.cost.train_seconds if record and record.cost else None,
        folder=str(folder),
    )


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
