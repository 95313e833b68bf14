"""Tables of choices: a row a candidate, what it changes, whether the tuning protocol would keep it, and why."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from ..numbers.choices import FEWEST_RUNS, LEAST_GAIN, Choice
from .columns import LPIPS, PRIMITIVES, PSNR, REGIONS, Column, in_region
from .table import Table, build_table

KIND = "choice"


def choice_table(choice: Choice) -> Table:
    """The candidates less the method as it is: means over all data sets, then PSNR on each."""
    title = f"{choice.name}: candidates less {_named(choice, choice.base)}"
    table = build_table(choice.numbers, title, KIND, _columns(choice), choice.candidates)
    return replace(table, datasets=choice.datasets, remarks=tuple(remarks(choice)))


def _columns(choice: Choice) -> list[Column]:
    everything = f"mean of {len(choice.datasets)}"
    columns = [_difference(choice, column, choice.datasets, everything) for column in (PSNR, LPIPS, PRIMITIVES)]
    columns[0] = replace(columns[0], with_interval=True)
    for region in REGIONS:
        having = choice.numbers.having(choice.datasets, region)
        if having:
            columns.append(_difference(choice, in_region(PSNR, region), having, everything))
    return columns + [_difference(choice, PSNR, (dataset,), dataset) for dataset in choice.datasets]


def _difference(choice: Choice, column: Column, datasets: tuple[str, ...], group: str) -> Column:
    return replace(column, title=f"Δ {column.title}", group=group, datasets=datasets, against=choice.base, ranked=False)


def remarks(choice: Choice) -> list[str]:
    """The rules, a verdict on each candidate and what it hangs on, and what other data sets would choose."""
    spreads = ", ".join(f"{dataset} {spread:.2f}" for dataset, spread in choice.spreads.items())
    found = [
        "Δ PSNR over all data sets has its 95 % bootstrap interval.",
        f"A candidate may be kept that gains {LEAST_GAIN:g} dB as the mean over all data sets, and on none loses more "
        f"than a run varies by its seed there (standard deviation over all rows, dB: {spreads or 'unknown'}).",
    ]
    for candidate in choice.candidates:
        found.append(f"{candidate}: {_verdict(choice, candidate)}.")
        found += [
            f"{candidate} hangs on {part.part} of {part.dataset}: {_signed(part.gain)} dB, and "
            f"{_signed(part.without)} without."
            for part in choice.deciding_parts(candidate)
        ]
    if len(choice.comparable) > 1 and len(choice.datasets) > 1:
        found.append(_leaving_one_out(choice))
    return found


def _verdict(choice: Choice, candidate: str) -> str:
    match choice.verdict(candidate):
        case "keep":
            return "may be kept"
        case "worse":
            lost = choice.losses(candidate).items()
            return "not to be kept, worse " + ", ".join(f"on {dataset} by {-loss:.2f} dB" for dataset, loss in lost)
        case "no gain":
            return f"not to be kept, it gains less than {LEAST_GAIN:g} dB"
        case "incomplete":
            where = ", ".join(choice.lacking(candidate))
            return f"undecided, a run did not finish or there are fewer than {FEWEST_RUNS} of both on {where}"


def _leaving_one_out(choice: Choice) -> str:
    chosen = {dataset: choice.chosen_without(dataset) for dataset in choice.datasets}
    gained = sum(choice.gain(row, dataset) for dataset, row in chosen.items()) / len(chosen)
    counts = Counter(chosen.values()).most_common()
    rows = ", ".join(f"{_named(choice, row)} ({n} of {len(chosen)} times)" for row, n in counts)
    return (
        f"Leaving out one data set, the mean of the others is best with: {rows}. On the ones left out that is "
        f"{_signed(gained)} dB."
    )


def _named(choice: Choice, row: str) -> str:
    return f"{choice.name} as it is" if row == choice.base else row


def _signed(gain: float) -> str:
    return f"{gain:+.2f}".replace("-", "−")
