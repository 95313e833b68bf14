"""Where the numbers came from: machines and versions, command lines, what training lacked, and what failed how."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from typing import Any

from envgs_bench.parts import LOSSES
from envgs_bench.records import Record

from ..tables.sections import LabeledRun, Section


def origins(section: Section) -> list[dict[str, Any]]:
    """Each combination of code, versions and machine among all of the section's runs, the most frequent first."""
    groups: dict[tuple[tuple[str, str], ...], int] = {}
    for run in (*(item.run for item in section.runs), *(item.run for item in section.perturbed)):
        facts = tuple(_facts(run.record))
        groups[facts] = groups.get(facts, 0) + 1
    ordered = sorted(groups.items(), key=lambda group: -group[1])
    return [{"title": f"{count} run{'s' * (count != 1)}: code, versions, machine", "facts": f} for f, count in ordered]


def commands(section: Section) -> list[dict[str, str]]:
    """A command line for every row of every table: the same settings, all its seeds."""
    rows: dict[tuple[str, str], list[LabeledRun]] = {}
    for dataset in section.datasets:
        for item in section.of(dataset):
            rows.setdefault((dataset, item.method), []).append(item)
    return [
        {"dataset": dataset, "method": method, "command": _command(items)} for (dataset, method), items in rows.items()
    ]


def dropped_losses(section: Section) -> list[dict[str, Any]]:
    """Every run that trained without a loss that its settings ask for, however it ended, a row a loss."""
    return [
        {
            "dataset": dataset,
            "method": item.method,
            "seed": item.run.record.seed,
            "loss": LOSSES.get(loss, loss),
            "why": why,
        }
        for dataset in section.datasets
        for item in section.of(dataset)
        for loss, why in item.run.record.dropped_losses.items()
    ]


def failures(section: Section) -> list[dict[str, Any]]:
    """Every run that did not finish, with its error and the end of its log."""
    found = []
    for dataset in section.datasets:
        for item in section.of(dataset):
            record = item.run.record
            if record.error is not None and not item.run.ok:
                found.append(
                    {
                        "dataset": dataset,
                        "method": item.method,
                        "seed": record.seed,
                        "status": record.status,
                        "message": str(record.error),
                        "log": record.error.log_tail,
                    }
                )
    return found


def _command(items: list[LabeledRun]) -> str:
    record = items[0].run.record
    overrides = [override for override in record.overrides if not override.startswith(("seed=", "runs_dir=", "force="))]
    given = {override.split("=", 1)[0] for override in overrides}
    for key, value in (("dataset", record.dataset), ("method", record.method)):
        if key not in given and "experiment" not in given:
            overrides.insert(0, f"{key}={value}")
    seeds = ",".join(str(item.run.record.seed) for item in items)
    return shlex.join(["envgs-bench", "run", *(["-m"] if len(items) > 1 else []), *overrides, f"seed={seeds}"])


def _facts(record: Record) -> Iterable[tuple[str, str]]:
    provenance = record.provenance
    commit = provenance.commit or "unknown"
    yield "version", provenance.version
    yield "commit", commit + {True: ", with uncommitted changes", False: "", None: ""}[provenance.dirty]
    yield "python", provenance.python
    yield "packages", _listed(provenance.packages)
    if record.metrics is not None:
        yield "weights of VGG-16", record.metrics.weights or "none"
    yield "machine", _listed(provenance.machine)
    yield "device", provenance.device if isinstance(provenance.device, str) else _listed(provenance.device)
    yield "threads", str(provenance.threads)


def _listed(values: Mapping[str, Any]) -> str:
    """Name and value of each entry; how busy others kept the machine differs from run to run and is left out."""
    told = {name: value for name, value in values.items() if name != "others_cores" and value is not None}
    return ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in told.items())
