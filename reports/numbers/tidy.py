"""The tidy table: one row a number. Every other table, chart and page of a report is computed from it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pandas as pd

from envgs_bench.records import Record

from .runs import Run

COLUMNS = ["dataset", "method", "seed", "region", "metric", "value"]
TIMES = ("frame_ms", "frame_ms_p95", "fps", "prepare_ms")
MEMORY = ("model_bytes", "peak_host_bytes", "peak_device_bytes")
FILES = ("checkpoint_bytes", "compact_bytes")
COSTS = ("train_seconds", *MEMORY, *FILES, "peak_primitives", "skipped_steps")


def tidy_table(runs: Sequence[tuple[str, str, Run]]) -> pd.DataFrame:
    """`COLUMNS` for the finished runs among (data set's label, method's label, run).

    Values are in the records' units (dB, ms, seconds, bytes), NaN for what could not be computed; `primitives` is the
    sum over the sets and `primitives_<set>` one set. A run whose pictures came from elsewhere has no times and costs.
    Times and costs have the region `full`; scores of unseen views have how these lie for a region.
    """
    rows = [
        (dataset, method, run.record.seed, region, metric, value)
        for dataset, method, run in runs
        if run.ok
        for region, metric, value in _numbers(run.record)
    ]
    frame = pd.DataFrame(rows, columns=COLUMNS)
    return frame.astype({"seed": "int64", "value": "float64"})


def attempts_table(runs: Sequence[tuple[str, str, Run]]) -> pd.DataFrame:
    """dataset, method, seed, status of every run, finished or not: the denominators of the tables."""
    rows = [(dataset, method, run.record.seed, run.record.status) for dataset, method, run in runs]
    return pd.DataFrame(rows, columns=["dataset", "method", "seed", "status"])


def _numbers(record: Record) -> Iterator[tuple[str, str, float | None]]:
    """region, metric, value: None for a score that could not be computed; times and costs not taken are absent."""
    for name, value in record.metrics.mean.items() if record.metrics else ():
        yield "full", name, value
    for region, scores in record.masked.items():
        for name, value in scores.scores.items():
            yield region, name, value
        yield region, "fraction", scores.fraction
    for place, metrics in record.unseen.items():
        for name, value in metrics.mean.items():
            yield place, name, value
    for part, names in ((record.timing, TIMES), (record.cost, COSTS)):
        for name in names:
            if (value := getattr(part, name, None)) is not None:
                yield "full", name, value
    for name in ("own_seconds", "agreement_db") if record.program is not None else ():
        if (value := getattr(record.program, name)) is not None:
            yield "full", name, value
    if record.cost is not None:
        if record.cost.primitives:
            yield "full", "primitives", sum(record.cost.primitives.values())
        for name, count in record.cost.primitives.items():
            yield "full", f"primitives_{name}", count
