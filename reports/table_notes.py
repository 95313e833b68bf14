"""What a table's numbers need said beside them."""

from __future__ import annotations

from math import log10

from .sections import Section
from .summary import Table


def caption(section: Section, table: Table) -> str:
    """Size and number of pictures of a data set, or the number of data sets of an average."""
    if len(table.datasets) > 1:
        return f"average over {len(table.datasets)} data sets, complete rows only"
    records = [item.run.record for item in section.of(table.title) if item.run.ok]
    sizes = sorted({f"{record.timing.width}×{record.timing.height}" for record in records if record.timing})
    views = sorted({len(record.metrics.per_view) for record in records if record.metrics})
    steps = sorted({record.steps for record in records})
    words = [f"{' and '.join(sizes)} pixels"] if sizes else []
    words += [f"{' or '.join(map(str, views))} test views"] if views else []
    words += [f"{' or '.join(f'{count:,}' for count in steps)} steps"] if steps else []
    return ", ".join(words)


def notes(section: Section, table: Table) -> list[str]:
    """Why cells are empty, how large the regions are, and what the paper's column means."""
    found = []
    for dataset in table.datasets:
        for metric, reasons in section.not_computed(dataset).items():
            found.append(f"n/c: {metric.upper()} was not computed: {'; '.join(reasons)}.")
    if len(table.datasets) == 1:
        shares = {
            name: item.run.record.masked[name].fraction
            for item in section.of(table.title)
            for name in item.run.record.masked
        }
        for name, share in shares.items():
            extra = f"; composited on white that alone adds {-10 * log10(share):.1f} dB of PSNR" if share > 0 else ""
            found.append(f"The {name.replace('_', '-')} region is {share:.1%} of the pixels{extra}.")
    if table.published:
        found.append(
            "PSNR paper: printed in the EnvGS paper, and ours minus it. Rows marked published: by the paper only."
        )
    return list(dict.fromkeys(found))
