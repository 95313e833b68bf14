"""Tables of candidates: a row a candidate, what it changes, whether the tuning protocol would keep it, and why."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from ...tables.columns import LPIPS, PRIMITIVES, PSNR, REGIONS, Column, in_region
from ...tables.table import Table, build_table
from .candidates import FEWEST_RUNS, LEAST_GAIN, Candidates

KIND = "candidates"


def candidates_table(found: Candidates) -> Table:
    """The candidates less the method as it is: means over all data sets, then PSNR on each."""
    title = f"{found.name}: candidates less {_named(found, found.base)}"
    table = build_table(found.numbers, title, KIND, _columns(found), found.rows)
    return replace(table, datasets=found.datasets, remarks=tuple(remarks(found)))


def _columns(found: Candidates) -> list[Column]:
    everything = f"mean of {len(found.datasets)}"
    columns = [_difference(found, column, found.datasets, everything) for column in (PSNR, LPIPS, PRIMITIVES)]
    columns[0] = replace(columns[0], with_interval=True)
    for region in REGIONS:
        having = found.numbers.having(found.datasets, region)
        if having:
            columns.append(_difference(found, in_region(PSNR, region), having, everything))
    return columns + [_difference(found, PSNR, (dataset,), dataset) for dataset in found.datasets]


def _difference(found: Candidates, column: Column, datasets: tuple[str, ...], group: str) -> Column:
    return replace(column, title=f"Δ {column.title}", group=group, datasets=datasets, against=found.base, ranked=False)


def remarks(found: Candidates) -> list[str]:
    """The rules, a verdict on each candidate and what it hangs on, and what other data sets would choose."""
    spreads = ", ".join(f"{dataset} {spread:.2f}" for dataset, spread in found.spreads.items())
    told = [
        "Δ PSNR over all data sets has its 95 % interval.",
        f"A candidate may be kept that gains {LEAST_GAIN:g} dB as the mean over all data sets, with the interval above "
        f"0, and on none lacks more than a run varies by its seed there "
        f"(standard deviation over all rows, dB: {spreads or 'unknown'}).",
    ]
    for candidate in found.rows:
        told.append(f"{candidate}: {_verdict(found, candidate)}.")
        told += [
            f"{candidate} hangs on {part.part} of {part.dataset}: {_signed(part.gain)} dB, and "
            f"{_signed(part.without)} without."
            for part in found.deciding_parts(candidate)
        ]
    if len(found.comparable) > 1 and len(found.datasets) > 1:
        told.append(_leaving_one_out(found))
    return told


def _verdict(found: Candidates, candidate: str) -> str:
    match found.verdict(candidate):
        case "keep":
            return "may be kept"
        case "loses":
            lost = found.losses(candidate).items()
            return "not to be kept, it loses " + ", ".join(f"on {dataset} by {-loss:.2f} dB" for dataset, loss in lost)
        case "no gain":
            return f"not to be kept, it gains less than {LEAST_GAIN:g} dB"
        case "not shown":
            return "not to be kept, seeds do not show that it is better"
        case "incomplete":
            where = ", ".join(found.lacking(candidate))
            return f"undecided, a run did not finish or there are fewer than {FEWEST_RUNS} of both on {where}"


def _leaving_one_out(found: Candidates) -> str:
    chosen = {dataset: found.chosen_without(dataset) for dataset in found.datasets}
    gained = sum(found.gain(row, dataset) for dataset, row in chosen.items()) / len(chosen)
    counts = Counter(chosen.values()).most_common()
    rows = ", ".join(f"{_named(found, row)} ({n} of {len(chosen)} times)" for row, n in counts)
    return (
        f"Leaving out one data set, the mean of the others is best with: {rows}. On the ones left out that is "
        f"{_signed(gained)} dB."
    )


def _named(found: Candidates, row: str) -> str:
    return f"{found.name} as it is" if row == found.base else row


def _signed(gain: float) -> str:
    return f"{gain:+.2f}".replace("-", "−")
