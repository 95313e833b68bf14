"""The CSV of kept perturbed runs, and of those that they are compared with: one short row a run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from envgs_bench.parts import REFLECTIVE
from envgs_bench.plain_text import no_formula
from envgs_bench.records import Record

from ..numbers.runs import Run
from .csv_file import read_rows, write_rows
from .runs_file import RunsFileError, commit_of, method_of

IDENTITY = ("scene", "method", "steps", "seed", "perturbed", "severity", "repair")  # a run of the same replaces a row
SAID = ("before", "during", "repaired")  # kinds: warned of before the first step, and after it; what a repair changed
COLUMNS = (*IDENTITY, "status", "psnr", "psnr_reflective", "primitives", *SAID, "device", "commit")
NONE = "none"
IMPOSSIBLE = "impossible"  # the scene lacks what is to be perturbed
UNTRIED = (IMPOSSIBLE, "interrupted")  # says nothing of the method


def row_of(run: Run, commit: str = "") -> dict[str, str]:
    """A run as a row.

    Args:
        commit: of runs that do not know theirs.
    """
    record, perturbed = run.record, run.record.perturbation
    masked, cost = record.masked.get(REFLECTIVE), record.cost
    numbers = {
        "psnr": record.metrics.mean.get("psnr") if record.metrics else None,
        "psnr_reflective": masked.scores.get("psnr") if masked else None,
        "primitives": sum(cost.primitives.values()) if cost and cost.primitives else None,
    }
    facts = {
        "scene": record.dataset,
        "method": method_of(record),
        "steps": record.config.get("steps", record.steps),  # of settings that are perturbed, those of the partner
        "seed": record.seed,
        "perturbed": perturbed.kind if perturbed else NONE,
        "severity": perturbed.severity if perturbed else 0,
        "repair": " ".join(record.repair) or NONE,
        "status": IMPOSSIBLE if record.error and record.error.type == "DatasetError" else record.status,
        "before": _kinds(record, at_start=True),
        "during": _kinds(record, at_start=False),
        "repaired": " ".join(sorted(outcome.kind for outcome in record.repairs if outcome.kept)),
        "device": run.device,
        "commit": commit_of(record, commit),
    }
    row = {name: no_formula(str(value)) for name, value in facts.items()}
    return row | {name: "" if value is None else f"{value:.6g}" for name, value in numbers.items()}


def _kinds(record: Record, at_start: bool) -> str:
    return " ".join(sorted({warning.kind for warning in record.warnings if (warning.step == 0) == at_start}))


def keep_perturbed(runs: Iterable[Run], path: Path, commit: str = "") -> int:
    """Add a row for each run to the file, in place of an earlier row of the same `IDENTITY`; how many rows it has.

    Raises:
        RunsFileError: the file that is there is no CSV of perturbed runs.
    """
    kept: dict[tuple[str, ...], Mapping[Any, Any]]
    kept = {} if not path.exists() else {_identity(row): row for row in read_perturbed(path).to_dict("records")}
    kept |= {_identity(row): row for row in (row_of(run, commit) for run in runs)}
    write_rows(path, COLUMNS, [kept[key] for key in sorted(kept)])
    return len(kept)


def read_perturbed(path: Path) -> pd.DataFrame:
    """The rows of a file of perturbed runs, all of them text.

    Raises:
        NoRunsError: there is no such file.
        RunsFileError: it is another.
    """
    command = f"envgs-bench report RUNS --keep-perturbed {path}"
    return read_rows(path, COLUMNS, RunsFileError, "perturbed runs", command, as_text=True)


def _identity(row: Mapping[Any, Any]) -> tuple[str, ...]:
    return tuple(str(row[name]) for name in IDENTITY)
