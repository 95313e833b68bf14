"""The CSV of kept runs: one row a run, with its scores, its costs, and what is needed to run it again."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from envgs_bench.plain_text import no_formula
from envgs_bench.records import EXTERNAL, Record

from ..numbers.cards import PLAIN, card_of
from ..numbers.labels import SET_UP
from ..numbers.runs import Run, is_processor
from ..numbers.tidy import COSTS, TIMES
from .csv_file import NoRunsError, read_rows, write_rows

IDENTITY = ("scene", "method", "steps", "split", "protocol", "seed")  # a run of the same replaces a row: `_identity`
FACTS = (*IDENTITY, "order", "status", "width", "height", "device", "commit", "run_id", "command")
ATTRIBUTE = "attribute_"  # before the names of a scene's attributes
DIGITS = 6  # of a number: more than any table prints
NOT_KEPT = ("checkpoint_bytes", "peak_host_bytes", "peak_device_bytes", "skipped_steps", "prepare_ms")

PLACES_OF_DATA = ("data_root", "dataset.root", "path")
PLACES_OF_OUTPUT = ("runs_dir=", "cache_dir=")
PLACES_OF_PROGRAMS = ("method.settings.home=", "method.settings.python=", "method.settings.isolation=")


class RunsFileError(ValueError):
    """A CSV of kept runs that cannot be used; the message names the file and what is wrong with it."""


def row_of(run: Run, commit: str = "") -> dict[str, str]:
    """A run as a row: facts, then every score as `<metric>` or `<metric>_<region>`, then its costs.

    Args:
        commit: of runs that do not know theirs.
    """
    record = run.record
    timing = record.timing
    facts = (
        record.dataset, method_of(record), record.steps, record.scored_on, record.protocol.name, record.seed,
        card_of(record).order, record.status, timing.width if timing else "", timing.height if timing else "",
        run.device, commit_of(record, commit), record.run_id, command_of(record),
    )  # fmt: skip
    row = {name: no_formula(str(value)) for name, value in zip(FACTS, facts, strict=True)}
    return row | {name: f"{value:.{DIGITS}g}" for name, value in numbers_of(record).items()}


def commit_of(record: Record, otherwise: str = "") -> str:
    """The commit that made the record, or the other where it knows none."""
    provenance = record.provenance
    return f"{(provenance.commit or otherwise or 'unknown')[:10]}{'-dirty' if provenance.dirty else ''}"


def method_of(record: Record) -> str:
    """Its name, and what its overrides change; where another program lies is none of that."""
    plain = ("method.name=", *PLACES_OF_PROGRAMS, *(("method.recipe=",) if record.kind == EXTERNAL else ()))
    changed = [each.lstrip("+~") for each in record.overrides]
    changed = [each for each in changed if each.startswith(SET_UP) and not each.startswith(plain)]
    return f"{record.method} [{', '.join(each.rsplit('.', 1)[-1] for each in changed)}]" if changed else record.method


def command_of(record: Record) -> str:
    """The command that does the run again at its commit; places on the machine that it ran on read FOLDER."""
    overrides = [each for each in record.overrides if not each.startswith((*PLACES_OF_OUTPUT, *PLACES_OF_PROGRAMS))]
    keys = [each.partition("=")[0] for each in overrides]
    overrides = [f"{key}=FOLDER" if key in PLACES_OF_DATA else each for key, each in zip(keys, overrides, strict=True)]
    return shlex.join(["envgs-bench", "run", *overrides])


def numbers_of(record: Record) -> dict[str, float]:
    """Every score and cost that the record has, and what its scene is like."""
    found: dict[str, float | None] = {f"{ATTRIBUTE}{name}": value for name, value in record.attributes.items()}
    found |= record.metrics.mean if record.metrics else {}
    for region, masked in record.masked.items():
        found |= {f"{metric}_{region}": value for metric, value in masked.scores.items()}
    for place, metrics in record.unseen.items():
        found |= {f"{metric}_{place}": value for metric, value in metrics.mean.items()}
    if record.cost is not None:
        found |= {"primitives": sum(record.cost.primitives.values())} if record.cost.primitives else {}
        found |= {f"primitives_{name}": count for name, count in record.cost.primitives.items()}
    told = ("own_seconds", "agreement_db")
    for part, names in ((record.cost, COSTS), (record.timing, TIMES), (record.program, told)):
        found |= {name: getattr(part, name, None) for name in names if name not in NOT_KEPT}
    return {name: value for name, value in found.items() if value is not None}


def keep_runs(runs: Iterable[Run], path: Path, commit: str = "") -> int:
    """Add a row for each run to the file; how many rows it has.

    An earlier row of the same `IDENTITY` goes, if both runs were on a GPU, or both on a processor.

    Raises:
        RunsFileError: the file that is there is no CSV of kept runs, or a run is perturbed or repaired.
    """
    runs = list(runs)
    if changed := [run for run in runs if run.record.perturbation or run.record.repair]:
        raise RunsFileError(
            f"{changed[0].folder}: a perturbed or repaired run shares no table with others; keep such runs with "
            "--keep-perturbed, or leave them out with --exclude"
        )
    kept: dict[tuple[str, ...], Mapping[Any, Any]]
    kept = {} if not path.exists() else {_identity(row): row for row in _rows(path).to_dict("records")}
    kept |= {_identity(row): row for row in (row_of(run, commit) for run in runs)}
    rows = sorted(kept.values(), key=lambda row: (row["scene"], int(row["steps"]), int(row["order"]), _identity(row)))
    names: set[str] = {name for row in rows for name in row}
    columns = [*FACTS, *PLAIN, *sorted(names - {*FACTS, *PLAIN})]  # regions' scores and costs come last
    write_rows(path, columns, rows)
    return len(rows)


def read_kept(path: Path) -> pd.DataFrame:
    """The rows of a file of kept runs; numbers that a run has not are NaN.

    Raises:
        NoRunsError: there is no such file, or no run in it.
        RunsFileError: it is no CSV of kept runs.
    """
    frame = _rows(path)
    if frame.empty:
        raise NoRunsError(f"{path.parent.name}/{path.name} has no run")
    numbers = [name for name in frame.columns if name not in FACTS or name in ("steps", "seed", "order")]
    frame[numbers] = frame[numbers].apply(pd.to_numeric)
    return frame


def _rows(path: Path) -> pd.DataFrame:
    """All of it as text."""
    return read_rows(path, FACTS, RunsFileError, "kept runs", f"envgs-bench report RUNS --keep {path}", as_text=True)


def _identity(row: Mapping[Any, Any]) -> tuple[str, ...]:
    return (*(row[name] for name in IDENTITY), "processor" if is_processor(row["device"]) else "GPU")
