"""Tables of a lead: a row a method that is behind or ahead, the mean over all data sets, then each of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from ..numbers.leads import Lead
from .columns import LPIPS, PSNR, Column, in_region
from .table import Cell, Row, Table, with_numbers

KIND = "lead"
OTHER = "the row's"  # what is subtracted


def lead_tables(lead: Lead | None) -> list[Table]:
    """PSNR of the whole picture, then of every region, then LPIPS: the leader's less each other method's."""
    if lead is None:
        return []
    regions = (in_region(PSNR, region) for region in lead.numbers.regions(lead.datasets))
    return [table for score in (PSNR, *regions, LPIPS) if (table := _table(lead, score)).rows]


def _table(lead: Lead, score: Column) -> Table:
    datasets = lead.numbers.having(lead.datasets, score.region)
    columns = tuple(_columns(lead, score, datasets))
    rows = [_row(lead, other, columns, datasets) for other in lead.others]
    rows = [row for row in rows if any(cell.mean is not None for cell in row.cells.values())]
    title = f"{lead.leader} less the others: {score.title}"
    return Table(title, KIND, with_numbers(columns, rows), tuple(rows), datasets, remarks=_remarks(lead, score))


def _columns(lead: Lead, score: Column, datasets: tuple[str, ...]) -> Iterator[Column]:
    explanation = f"{lead.leader}'s minus {OTHER}, seed by seed"
    difference = replace(
        score, title=f"Δ {score.title}", against=OTHER, explanation=explanation, with_interval=True, ranked=False
    )
    if len(datasets) > 1:
        yield replace(difference, group=f"mean of {len(datasets)}", datasets=datasets)
    for dataset in datasets:
        yield replace(difference, group=dataset, datasets=(dataset,))


def _row(lead: Lead, other: str, columns: tuple[Column, ...], datasets: tuple[str, ...]) -> Row:
    cells = {c.key: Cell(c, lead.over(other, c.datasets, c.region, c.metric)) for c in columns}
    return Row(other, cells, lead.numbers.statuses(datasets, other))


def _remarks(lead: Lead, score: Column) -> tuple[str, ...]:
    ahead = "above" if score.better == "higher" else "below"
    return (
        f"{lead.leader} has the best mean PSNR on the most data sets. Δ: its {score.title} minus {OTHER}, paired by "
        f"seed, so {ahead} 0 it is ahead; with the 95 % interval of Student's t, which holds 0 where seeds do not show "
        "who is.",
    )
