"""Section: the runs that may share a table, because one protocol scored the same views and one device timed them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import pandas as pd

from envgs_bench.parts import MethodCard, MetricCard
from envgs_bench.records import ProtocolName, Record, RepairName, ScoredOn

from ..numbers.cards import metric_cards, newest_cards
from ..numbers.estimates import Numbers
from ..numbers.labels import Label, label_runs, method_order
from ..numbers.published import PROTOCOLS, paper_method, paper_scene
from ..numbers.runs import UNTIMED, Run
from ..numbers.settings import method_settings
from ..numbers.swept_settings import sweeps
from ..numbers.tidy import attempts_table, tidy_table
from .layouts import Contents, layouts
from .table import DroppedLoss, Table

ALL = "all data sets"
LONGEST_SLUG = 120  # characters


@dataclass(frozen=True)
class LabeledRun:
    dataset: str
    method: str
    label: Label  # the method's, with the settings that set it apart
    run: Run


@dataclass(frozen=True)
class Section:
    protocol: ProtocolName
    scored_on: ScoredOn
    repair: tuple[RepairName, ...]
    device: str
    runs: tuple[LabeledRun, ...]  # the unperturbed ones
    superseded: tuple[LabeledRun, ...]  # older runs of the same data set, method and seed
    with_perturbed: tuple[LabeledRun, ...]  # perturbed runs and those above, told apart; () where nothing is perturbed

    @property
    def title(self) -> str:
        return f"Protocol {self.protocol.name} ({self.protocol.hash}){self._apart} on {self.device}"

    @property
    def slug(self) -> str:
        """A short name for files, of letters, digits and dashes."""
        words = f"{self.protocol.name} {self.protocol.hash[:8]}{self._apart} {self.device}"
        return re.sub(r"[^a-z0-9]+", "-", words.lower())[:LONGEST_SLUG].strip("-")

    @property
    def short(self) -> str:
        return f"{self.protocol.name}{self._apart}, {self.device}"

    @property
    def _apart(self) -> str:
        """What names say of the views: test views of a scene as given go without saying."""
        views = "" if self.scored_on == "test" else f", {self.scored_on} views"
        return views + (f", repair of {' and '.join(self.repair)}" if self.repair else "")

    def csv_name(self, index: int, table: str = "table") -> str:
        """The file of the section's tidy table, or of another: the first section's has the plain name."""
        return f"{table}-{self.slug}.csv" if index else f"{table}.csv"

    @cached_property
    def datasets(self) -> list[str]:
        return sorted(self._by_dataset)

    @cached_property
    def methods(self) -> list[str]:
        return sorted(self.labels, key=lambda row: method_order(self.labels[row]))

    @cached_property
    def tidy(self) -> pd.DataFrame:
        return tidy_table([(dataset, item.method, item.run) for dataset in self.datasets for item in self.of(dataset)])

    @cached_property
    def numbers(self) -> Numbers:
        return Numbers(self.tidy, attempts_table([(item.dataset, item.method, item.run) for item in self.runs]))

    @property
    def perturbed(self) -> list[LabeledRun]:
        return [item for item in self.with_perturbed if item.run.record.perturbation is not None]

    @cached_property
    def labels(self) -> dict[str, Label]:
        """Row -> its method's label."""
        return {item.method: item.label for item in self.runs}

    @cached_property
    def cards(self) -> dict[str, MethodCard]:
        """Method's name -> its card, of all methods of the section, in the tables' order."""
        found = newest_cards(item.run.record for item in (*self.runs, *self.with_perturbed))
        return dict(sorted(found.items(), key=lambda item: (item[1].order, item[0])))

    def card(self, row: str) -> MethodCard:
        """The card of a row's method."""
        return self.cards[self.labels[row].name]

    @cached_property
    def metrics(self) -> dict[str, MetricCard]:
        """Metric's name -> its card, in the tables' order."""
        return metric_cards(item.run.record for item in self.runs)

    @cached_property
    def published(self) -> dict[str, str]:
        """Row -> the paper's name of it, its own where the paper has none."""
        kinds = {item.method: item.run.record.kind for item in self.runs}
        return {row: paper_method(row, self.card(row), kinds[row]) for row in self.labels}

    @cached_property
    def tables(self) -> list[Table]:
        """The ordinary ones, in the order of every format: studies have tables of their own."""
        alone = {name: (name,) for name in self.datasets}
        contents = Contents(
            self.numbers,
            self.families | alone,
            {row: self.labels[row] for row in self.methods},
            {row: self.card(row) for row in self.methods},
            self.metrics,
            self.published if self.protocol.name in PROTOCOLS else None,
            self.protocol.name,
        )
        return [self.with_dropped_losses(table) for table in layouts(contents, ALL)]

    def with_dropped_losses(self, table: Table) -> Table:
        """The table with what its rows' runs trained without."""
        rows = (
            replace(row, dropped=tuple(d for name in table.datasets for d in self._dropped.get((name, row.method), ())))
            for row in table.rows
        )
        return replace(table, rows=tuple(rows))

    @cached_property
    def _dropped(self) -> dict[tuple[str, str], list[DroppedLoss]]:
        """What the finished runs of a data set and method trained without."""
        finished: dict[tuple[str, str], list[Record]] = {}
        for item in self.runs:
            if item.run.ok:
                finished.setdefault((item.dataset, item.method), []).append(item.run.record)
        found = {}
        for (dataset, method), records in finished.items():
            counts = Counter(pair for record in records for pair in record.dropped_losses.items())
            found[dataset, method] = [DroppedLoss(*pair, dataset, n, len(records)) for pair, n in counts.items()]
        return found

    @property
    def subjects(self) -> list[Table]:
        """What is known of each data set and of the mean over each family, those first: what charts are drawn from."""
        return [table for table in self.tables if table.kind == "subject"]

    @cached_property
    def settings(self) -> dict[str, dict[str, str]]:
        """Every setting of each method, as text, its code's name ("kind") and the steps among them."""
        return {
            item.method: method_settings(item.run.record)
            | {"kind": item.run.record.kind, "steps": str(item.run.record.steps)}
            for item in reversed(self.runs)
        }

    @cached_property
    def sweeps(self) -> list[list[str]]:
        """The methods that one swept setting joins, by its value."""
        return sweeps(self.settings)

    @cached_property
    def families(self) -> dict[str, tuple[str, ...]]:
        """Families of two data sets and more by name, then all data sets where that adds any.

        A data set's family is the paper's where the paper has it, or the first part of its name (`toy/chrome_room`),
        or the kind of its source.
        """
        groups: dict[str, list[str]] = {}
        kinds = {item.dataset: item.run.record.config.get("dataset", {}).get("kind") for item in self.runs}
        for dataset in self.datasets:
            scene = paper_scene(dataset)
            first, slash, _ = dataset.partition("/")
            family = scene[0] if scene else first if slash else str(kinds[dataset] or dataset)
            groups.setdefault(family, []).append(dataset)
        several = {family: tuple(members) for family, members in groups.items() if len(members) > 1}
        if len(groups) > 1:
            several[ALL] = tuple(self.datasets)
        return several

    def of(self, dataset: str) -> list[LabeledRun]:
        """The data set's runs, methods in the tables' order, seeds ascending."""
        return self._by_dataset[dataset]

    @cached_property
    def _by_dataset(self) -> dict[str, list[LabeledRun]]:
        order = {method: index for index, method in enumerate(self.methods)}
        found: dict[str, list[LabeledRun]] = {}
        for item in sorted(self.runs, key=lambda item: (order[item.method], item.run.record.seed)):
            found.setdefault(item.dataset, []).append(item)
        return found

    def not_computed(self, dataset: str) -> dict[str, list[str]]:
        """Metric -> the reasons why it is missing from some finished run on the data set."""
        reasons: dict[str, set[str]] = {}
        for item in self.of(dataset):
            if item.run.record.metrics is not None:
                for metric, why in item.run.record.metrics.not_computed.items():
                    reasons.setdefault(metric, set()).add(why)
        return {metric: sorted(why) for metric, why in sorted(reasons.items())}


def split_sections(runs: Sequence[Run]) -> list[Section]:
    """Sections by protocol (name and hash), scored views, repair of the scene and device, that with most runs first.

    Perturbed runs are kept apart within each. Runs that took no times, as their pictures came from elsewhere, stand
    beside every device's.
    """
    groups: dict[tuple[str, str, ScoredOn, tuple[RepairName, ...]], dict[str, list[Run]]] = {}
    for run in runs:
        record = run.record
        alike = (record.protocol.name, record.protocol.hash, record.scored_on, record.repair)
        groups.setdefault(alike, {}).setdefault(run.device, []).append(run)
    sections = []
    for devices in groups.values():
        untimed = devices.pop(UNTIMED, [])
        sections += [_section([*group, *untimed], device) for device, group in devices.items()]
        if not devices:
            sections.append(_section(untimed, UNTIMED))
    return sorted(sections, key=lambda section: (-len(section.runs), section.title))


def _section(runs: list[Run], device: str) -> Section:
    current, superseded = _newest([run for run in runs if run.record.perturbation is None])
    perturbed = any(run.record.perturbation is not None for run in runs)
    everything = _newest(runs)[0] if perturbed else ()
    record = runs[0].record
    return Section(record.protocol, record.scored_on, record.repair, device, current, superseded, everything)


def _newest(runs: list[Run]) -> tuple[tuple[LabeledRun, ...], tuple[LabeledRun, ...]]:
    """The newest run of each data set, method, seed and perturbation, labeled; and those that are older."""
    labels = label_runs(runs)
    newest: dict[tuple[object, ...], LabeledRun] = {}
    superseded = []
    for index in sorted(range(len(runs)), key=lambda i: runs[i].record.provenance.finished):
        dataset, method = labels[index]
        item = LabeledRun(str(dataset), str(method), method, runs[index])
        perturbed = item.run.record.perturbation
        apart = (perturbed.kind, perturbed.severity) if perturbed is not None else ()
        key = (item.dataset, item.method, item.run.record.seed, apart)
        if key in newest:
            superseded.append(newest[key])
        newest[key] = item
    return tuple(newest.values()), tuple(superseded)
