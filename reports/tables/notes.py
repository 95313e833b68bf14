"""What a table's numbers need said beside them."""

from __future__ import annotations

from collections import Counter
from math import log10

from envgs_bench.parts import LOSSES

from ..numbers.published import printed_by
from ..numbers.runs import Run
from ..numbers.spoiled_views import SPOILED_BY, spoiled_views
from .entries import DAGGER
from .sections import Section
from .table import Table

QUIET_CORES = 0.2  # what others may use of a machine that counts as ours
TOLD_VIEWS = 3  # spoiled ones that a note names


def caption(section: Section, table: Table) -> str:
    """Size and number of pictures of a data set, or the number of data sets of a mean."""
    if table.told:
        return table.told
    if len(table.datasets) > 1:
        mean = f"mean of {len(table.datasets)} data sets, complete rows only"
        return mean if section.scored_on == "test" else f"{mean}, {section.scored_on} views"
    records = [item.run.record for item in section.of(table.datasets[0]) if item.run.ok]
    sizes = sorted({f"{record.timing.width}×{record.timing.height}" for record in records if record.timing})
    views = sorted({len(record.metrics.per_view) for record in records if record.metrics})
    steps = sorted({record.steps for record in records if record.steps})  # none for pictures from elsewhere
    words = [f"{' and '.join(sizes)} pixels"] if sizes else []
    words += [f"{' or '.join(map(str, views))} {section.scored_on} views"] if views else []
    words += [f"{' or '.join(f'{count:,}' for count in steps)} steps"] if steps else []
    return ", ".join(words)


def notes(section: Section, table: Table) -> list[str]:
    """What was dropped, repaired, warned of, spoiled or published, why cells are empty, and how large regions are."""
    if table.told:
        return list(table.remarks)
    found = dropped_losses(table)
    if any(cell.text == "n/c" for row in table.rows for cell in row.cells.values()):
        for dataset in table.datasets:
            for metric, reasons in section.not_computed(dataset).items():
                found.append(f"n/c: {metric.upper()} was not computed: {'; '.join(reasons)}.")
    found += _shares(section, table)
    if table.kind == "subject":
        found += _parts(table) + _changed(section, table) + _noticed(section, table) + _spoiled(section, table)
    if any(column.metric == "frame_ms" for column in table.columns):
        found += _company(section, table)
    if any(column.against and not column.with_interval for column in table.columns):
        found.append("Δ: the mean over seeds of the difference on the same seed, with the spread of that difference.")
    found += _given(section, table)
    if table.published:
        printed = printed_by(table.datasets, section.protocol.name)
        found.append(f"Paper: printed {printed}, and ours minus it. Rows marked published: printed there only.")
        found.append("Printed values stand beside a method as its authors have it, not as this project configures it.")
    if any(column.elsewhere for column in table.columns):
        found.append("The paper's frame rates and training times are of its machine, an RTX 4090, not of this one.")
    return [*dict.fromkeys(found), *table.remarks]


def dropped_losses(table: Table) -> list[str]:
    """What the dagger on a method means: a sentence a loss and reason, naming the methods and where it was dropped."""
    methods: dict[tuple[str, str, str], list[str]] = {}
    for row in table.rows:
        places: dict[tuple[str, str], list[str]] = {}
        for item in row.dropped:
            where = [f"on {item.dataset}"] if len(table.datasets) > 1 else []
            where += [f"in {item.runs} of {item.done} runs"] if item.runs < item.done else []
            places.setdefault((item.loss, item.why), []).append(" ".join(where))
        for (loss, why), found in places.items():
            methods.setdefault((loss, why, ", ".join(filter(None, found))), []).append(row.method)
    return [
        f"{DAGGER} {', '.join(names)}: trained without {LOSSES.get(loss, loss)}{f' {where}' if where else ''}: {why}."
        for (loss, why, where), names in methods.items()
    ]


def _given(section: Section, table: Table) -> list[str]:
    """What methods were given besides photographs, poses and points: those of one kind of data compare best."""
    methods: dict[str, list[str]] = {}
    for row in table.rows:
        items = [item for name in table.datasets for item in section.of(name) if item.method == row.method]
        words = dict.fromkeys(word for item in items if item.run.ok for word in item.run.record.given)
        if words:
            methods.setdefault(", ".join(words), []).append(row.method)
    return [f"Given besides photographs, poses and points: {'; '.join(_words(methods))}."] if methods else []


def _words(methods: dict[str, list[str]]) -> list[str]:
    return [f"{', '.join(names)}: {given}" for given, names in methods.items()]


def _shares(section: Section, table: Table) -> list[str]:
    """How much of the pixels the table's regions are. White around a region has no error: it adds −10·log₁₀(share)."""
    regions = {column.region for column in table.columns} if len(table.datasets) == 1 else set()
    shares: dict[str, float] = {}
    for dataset in table.datasets:
        for item in section.of(dataset):
            shares |= {name: scores.fraction for name, scores in item.run.record.masked.items() if name in regions}
    words = [
        f"{name.replace('_', '-')} {share:.1%}" + (f" ({-10 * log10(share):.1f} dB)" if share > 0 else "")
        for name, share in sorted(shares.items())
    ]
    if not words:
        return []
    return [f"Of the pixels: {', '.join(words)}; in brackets what compositing the region on white adds to its PSNR."]


def _parts(table: Table) -> list[str]:
    """Over how many of the data sets a column is, where some do not have its region."""
    counts = sorted({len(column.datasets) for column in table.columns} - {len(table.datasets)})
    titles = {count: [column.title for column in table.columns if len(column.datasets) == count] for count in counts}
    return [
        f"{', '.join(titles[count])}: over the {count} of {len(table.datasets)} data sets that have the region."
        for count in counts
    ]


def _changed(section: Section, table: Table) -> list[str]:
    """Which runs on a data set of their own table read other files of it, as before and after one was corrected."""
    if len(table.datasets) > 1:
        return []
    finished = [item for name in table.datasets for item in section.of(name) if item.run.ok and item.run.record.data]
    read: dict[str | None, Counter[str]] = {}
    for item in sorted(finished, key=lambda item: item.run.record.provenance.finished):
        read.setdefault(item.run.record.data, Counter())[item.method] += 1
    if len(read) < 2:
        return []
    runs = sum(read.values(), Counter[str]())
    told = (
        ", ".join(_how_many(name, count, runs[name]) for name, count in methods.items()) for methods in read.values()
    )
    return [
        "Files of the data set changed between runs (photographs, cameras, masks or normals): "
        f"{'; then '.join(told)}. Run the earlier ones again to compare them."
    ]


def _noticed(section: Section, table: Table) -> list[str]:
    """What runs on a data set of their own table repaired of it, found by a pilot run or warned of, naming the methods.

    Of warnings that differ in their numbers alone the first is told.
    """
    if len(table.datasets) > 1:
        return []
    finished: Counter[str] = Counter()
    told: dict[object, tuple[str, Counter[str]]] = {}
    for item in section.of(table.datasets[0]):
        if not item.run.ok:
            continue
        finished[item.method] += 1
        sentences: dict[object, str] = {note: note for note in item.run.record.notes}
        for warning in item.run.record.warnings:
            words = f"{warning.kind} {warning.part}".rstrip().replace("_", " ")
            sentences.setdefault((warning.kind, warning.part), f"warning: {words}: {warning.message}")
        for key, sentence in sentences.items():
            told.setdefault(key, (sentence, Counter()))[1][item.method] += 1
    return [
        f"{', '.join(_how_many(method, count, finished[method]) for method, count in methods.items())}: {sentence}."
        for sentence, methods in told.values()
    ]


def _spoiled(section: Section, table: Table) -> list[str]:
    """Which views a single seed spoiled, on a data set of their own table: a sentence a method."""
    if len(table.datasets) > 1:
        return []
    runs: dict[str, list[Run]] = {}
    for item in section.of(table.datasets[0]):
        runs.setdefault(item.method, []).append(item.run)
    found = []
    for method, seeds in runs.items():
        spoiled = spoiled_views(seeds)
        views = {view for run in seeds if run.ok for view in run.of_views("psnr")}
        told = [f"{s.view} (seed {s.seed} {s.psnr:.1f} dB, others from {s.others:.1f})" for s in spoiled[:TOLD_VIEWS]]
        told += [f"{len(spoiled) - TOLD_VIEWS} more"] if len(spoiled) > TOLD_VIEWS else []
        if spoiled:
            found.append(
                f"{method}: {len(spoiled)} of {len(views)} views spoiled by one seed, {SPOILED_BY:g} dB and more below "
                f"every other seed's: {', '.join(told)}."
            )
    return found


def _how_many(method: str, count: int, of: int) -> str:
    return method if count == of else f"{method} ({count} of {of} runs)"


def _company(section: Section, table: Table) -> list[str]:
    """Times taken while others used the machine are no better than upper bounds, and say so."""
    runs = [item.run for dataset in table.datasets for item in section.of(dataset)]
    provenances = [run.record.provenance for run in runs if run.ok]
    busy = max((p.machine.get("others_cores") or 0 for p in provenances), default=0)
    shared = sum(isinstance(p.device, dict) and bool(p.device.get("shared")) for p in provenances)
    found = []
    if busy >= QUIET_CORES:
        found.append(f"Others kept up to {busy:.1f} processor cores busy meanwhile: times are upper bounds.")
    if shared:
        found.append(
            f"Others used the device during {shared} of {len(provenances)} runs: their times are upper bounds."
        )
    return found
