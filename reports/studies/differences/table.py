"""Tables of differences to the best: a row a method, the mean over all data sets, then each of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from ...tables.columns import LPIPS, PSNR, Column, in_region
from ...tables.table import Cell, Row, Table, with_numbers
from .differences import Differences

KIND = "differences"
OTHER = "the row's"  # what is subtracted


def difference_tables(found: Differences) -> list[Table]:
    """PSNR of the whole picture, then of every region, then LPIPS: the best method's less each other's."""
    regions = (in_region(PSNR, region) for region in found.numbers.regions(found.datasets))
    return [table for score in (PSNR, *regions, LPIPS) if (table := _table(found, score)).rows]


def _table(found: Differences, score: Column) -> Table:
    datasets = found.numbers.having(found.datasets, score.region)
    columns = tuple(_columns(found, score, datasets))
    rows = [_row(found, other, columns, datasets) for other in found.others]
    rows = [row for row in rows if any(cell.mean is not None for cell in row.cells.values())]
    title = f"{found.best} less the others: {score.title}"
    return Table(title, KIND, with_numbers(columns, rows), tuple(rows), datasets, remarks=_remarks(found, score))


def _columns(found: Differences, score: Column, datasets: tuple[str, ...]) -> Iterator[Column]:
    explanation = f"{found.best}'s minus {OTHER}, seed by seed"
    difference = replace(
        score, title=f"Δ {score.title}", against=OTHER, explanation=explanation, with_interval=True, ranked=False
    )
    if len(datasets) > 1:
        yield replace(difference, group=f"mean of {len(datasets)}", datasets=datasets)
    for dataset in datasets:
        yield replace(difference, group=dataset, datasets=(dataset,))


def _row(found: Differences, other: str, columns: tuple[Column, ...], datasets: tuple[str, ...]) -> Row:
    cells = {c.key: Cell(c, found.to(other, c.datasets, c.region, c.metric).difference) for c in columns}
    return Row(other, cells, found.numbers.statuses(datasets, other))


def _remarks(found: Differences, score: Column) -> tuple[str, ...]:
    ahead = "above" if score.better == "higher" else "below"
    return (
        f"{found.best} has the best mean PSNR on the most data sets. Δ: its {score.title} minus {OTHER}, paired by "
        f"seed, so {ahead} 0 it is ahead; with its 95 % interval, which holds 0 where seeds do not show who is.",
    )
