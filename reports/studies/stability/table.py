"""Tables of perturbed runs: a row a method and severity, what became of them and what they lost to their partners."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from decimal import Decimal

from ...numbers.estimates import Estimate
from ...tables.columns import MEGA, NORMALS, PSNR, TRAIN_SECONDS, Column, in_region
from ...tables.table import Cell as TableCell
from ...tables.table import Row, Table
from .perturbed_runs import FAILURES, SURVIVED, UNTRIED
from .seed_distances import SEED_DISTANCES
from .stability import Case, Cell, Stability

KIND = "stability"
PARTNER = "partner"  # what is subtracted where a column is a difference
OUTCOMES = {SURVIVED: "ok", **FAILURES, **UNTRIED}  # as the tables' column of runs names them


def _change(column: Column) -> Column:
    return replace(column, title=f"Δ {column.title}", against=PARTNER, explanation="minus its unperturbed partner's")


def _view(metric: str, title: str, explanation: str) -> Column:
    return Column(metric, "full", title, 2, "higher", "PSNR, dB", explanation, ranked=False)


def _count(metric: str, title: str, explanation: str, places: int = 0, scale: Decimal = Decimal(1)) -> Column:
    return Column(metric, "full", title, places, "lower", title, explanation, ranked=False, scale=scale)


def _between(metric: str, title: str, explanation: str, places: int, scale: Decimal = Decimal(1)) -> Column:
    return _count(metric, title, f"{explanation}; between the models of two seeds", places, scale)


WHOLE = replace(PSNR, ranked=False)
REFLECTIVE = replace(in_region(PSNR, "reflective"), metric="psnr_reflective", region="full", ranked=False)
CHANGE = _change(WHOLE)
ALIGNED = replace(WHOLE, metric="psnr_aligned", title="PSNR aligned", explanation="each view from where it fits best")
COLUMNS = (  # the metric is the quantity's name
    WHOLE,
    CHANGE,
    ALIGNED,
    REFLECTIVE,
    _change(REFLECTIVE),
    _view("psnr_median_view", "median view", "PSNR of the median view of each run"),
    _view("psnr_p5_view", "5 % view", "5th percentile of the views' PSNR of each run"),
    _view("psnr_worst_view", "worst view", "PSNR of the worst view of each run"),
    replace(NORMALS, ranked=False),
    _count("skipped_steps", "skipped", "steps whose loss or gradient was not finite"),
    _count("peak_primitives", "peak primitives", "at any step"),
    _count("peak_memory_bytes", "peak MB", "the device's where there is one", scale=MEGA),
    replace(TRAIN_SECONDS, ranked=False, places=1),
    _between("seeds_depth", "seeds: depth %", "of the scene radius: median over pixels", 2, Decimal(100)),
    _between("seeds_normal_degrees", "seeds: normal error °", "mean angle over pixels", 1),
    _between("seeds_reflected_rmse", "seeds: reflected", "RMSE, sRGB, of what rays see after the true mirrors", 3),
)


def stability_tables(stability: Stability) -> list[Table]:
    """One a data set and kind of perturbation, with the unperturbed runs as severity 0."""
    return [_table(stability, case) for case in stability.cases]


def _table(stability: Stability, case: Case) -> Table:
    dataset, kind = case
    severities = [0, *stability.severities(case)]
    rows = [
        _row(stability.cell(case, severity, method), method, severity)
        for method in stability.methods_of(case)
        for severity in severities
        if stability.runs(case, severity, method)
    ]
    kept = tuple(c for c in COLUMNS if any(row.cells[c.key].mean is not None for row in rows))
    levels = [f"{severity}: {stability.level(case, severity)}" for severity in severities if severity]
    return Table(
        f"{dataset}: {kind}", KIND, kept, tuple(rows), (dataset,), "; ".join(levels), tuple(remarks(stability, case))
    )


def _row(cell: Cell, method: str, severity: int) -> Row:
    statuses = Counter({OUTCOMES[name]: count for name, count in cell.outcomes.items()})
    cells = {c.key: TableCell(c, _estimate(cell, c)) for c in COLUMNS}
    return Row(f"{method}, severity {severity}" if severity else f"{method}, unperturbed", cells, statuses)


def _estimate(cell: Cell, column: Column) -> Estimate:
    if column.metric in SEED_DISTANCES:
        return cell.seed_distance(column.metric)
    return cell.change(column.metric) if column.against else cell.values(column.metric)


def remarks(stability: Stability, case: Case) -> list[str]:
    """What has to be said beside a case's numbers: its gates, and what could not be compared."""
    found = []
    cells = {
        (method, severity): stability.cell(case, severity, method)
        for method in stability.methods_of(case)
        for severity in stability.severities(case)
    }
    for (method, severity), cell in cells.items():
        if cell.unpaired:
            found.append(
                f"{method}, severity {severity}: {cell.unpaired} of {len(cell.tried)} runs have no finished partner "
                "(unperturbed, of the same settings, steps and seed): judged by their status alone."
            )
    gates = stability.gates(case)
    if any(run.gates is None for cell in cells.values() for run in cell.runs):
        found.append("Some runs carry no gates that can be read: judged by their status alone.")
    if len(gates) > 1:
        found.append("The runs carry different gates, and each is judged by its own.")
    for gate in gates:
        found.append(
            f"Survived: finished, at most {gate.psnr_drop_db:g} dB below the partner ({gate.region_drop_db:g} dB in "
            f"the reflective region), else collapsed; at most {gate.count_factor:g} × its peak primitives and "
            f"{gate.memory_factor:g} × its peak memory, else exploded; at most {gate.time_factor:g} × its training "
            "time."
        )
    return found
