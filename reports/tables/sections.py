"""Section: the runs that may share a table, because one protocol scored the same views and one device timed them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import pandas as pd

from envgs_bench.records import ProtocolName, Record, RepairKind, ScoredOn

from ..numbers.choices import Choice, choices
from ..numbers.estimates import Numbers
from ..numbers.knobs import knobs
from ..numbers.labels import Label, label_runs, method_order
from ..numbers.ladder import Ladder, ladders
from ..numbers.leads import Lead, lead
from ..numbers.published import PROTOCOL, paper_scene
from ..numbers.runs import UNTIMED, Run
from ..numbers.settings import method_settings
from ..numbers.stability import LabeledTrialRun, Stability
from ..numbers.tidy import attempts_table, tidy_table
from .choices import choice_table
from .ladder import ladder_table
from .layouts import Contents, layouts
from .leads import lead_tables
from .stability import stability_tables
from .table import DroppedLoss, Row, Table

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
    repair: tuple[RepairKind, ...]
    device: str
    runs: tuple[LabeledRun, ...]  # the unperturbed ones
    superseded: tuple[LabeledRun, ...]  # older runs of the same data set, method and seed
    stability: Stability  # of the perturbed runs, which are in nothing else, and their partners

    @property
    def title(self) -> str:
        return f"Protocol {self.protocol.name} ({self.protocol.hash}){self._views} on {self.device}"

    @property
    def slug(self) -> str:
        """A short name for files, of letters, digits and dashes."""
        words = f"{self.protocol.name} {self.protocol.hash[:8]}{self._views} {self.device}"
        return re.sub(r"[^a-z0-9]+", "-", words.lower())[:LONGEST_SLUG].strip("-")

    @property
    def short(self) -> str:
        return f"{self.protocol.name}{self._views}, {self.device}"

    @property
    def _views(self) -> str:
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
        labels = {item.method: item.label for item in self.runs}
        return sorted(labels, key=lambda method: method_order(labels[method]))

    @cached_property
    def tidy(self) -> pd.DataFrame:
        return tidy_table([(dataset, item.method, item.run) for dataset in self.datasets for item in self.of(dataset)])

    @cached_property
    def numbers(self) -> Numbers:
        return Numbers(self.tidy, attempts_table([(item.dataset, item.method, item.run) for item in self.runs]))

    @cached_property
    def ladders(self) -> list[Ladder]:
        return ladders(self.numbers, [(item.dataset, item.label, item.run) for item in self.runs])

    @cached_property
    def choices(self) -> list[Choice]:
        """Of validation views alone: settings are not chosen on test views."""
        if self.scored_on == "test":
            return []
        return choices(self.numbers, [(item.dataset, item.label, item.run) for item in self.runs])

    @cached_property
    def lead(self) -> Lead | None:
        """Of test views alone: of validation views `choices` says what is ahead."""
        return lead(self.numbers, self.datasets, self.methods) if self.scored_on == "test" else None

    @cached_property
    def tables(self) -> list[Table]:
        """In the order of every format."""
        alone = {name: (name,) for name in self.datasets}
        contents = Contents(
            self.numbers,
            self.families | alone,
            self.methods,
            {item.method: item.label for item in self.runs},
            self.protocol.name == PROTOCOL,
        )
        compared = [*map(choice_table, self.choices), *lead_tables(self.lead)]
        ordinary = [
            replace(table, rows=tuple(self._with_dropped_losses(row, table.datasets) for row in table.rows))
            for table in (*compared, *layouts(contents, ALL), *map(ladder_table, self.ladders))
        ]
        return [*ordinary, *stability_tables(self.stability)]

    def _with_dropped_losses(self, row: Row, datasets: Sequence[str]) -> Row:
        return replace(row, dropped=tuple(d for name in datasets for d in self._dropped.get((name, row.method), ())))

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
    def knobs(self) -> list[list[str]]:
        """The methods that one turned knob joins, by its value."""
        return knobs(self.settings)

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
    groups: dict[tuple[str, str, ScoredOn, tuple[RepairKind, ...]], dict[str, list[Run]]] = {}
    for run in runs:
        record = run.record
        key = (record.protocol.name, record.protocol.hash, record.scored_on, record.repair)
        devices = groups.setdefault(key, {})
        devices.setdefault(run.device, []).append(run)
    sections = []
    for devices in groups.values():
        untimed = devices.pop(UNTIMED, [])
        sections += [_section([*group, *untimed], device) for device, group in devices.items()]
        if not devices:
            sections.append(_section(untimed, UNTIMED))
    return sorted(sections, key=lambda section: (-len(section.runs), section.title))


def _section(runs: list[Run], device: str) -> Section:
    unperturbed = [run for run in runs if run.record.perturbation is None]
    labels = label_runs(unperturbed)
    newest: dict[tuple[str, str, int], LabeledRun] = {}
    superseded = []
    for index in sorted(range(len(unperturbed)), key=lambda i: unperturbed[i].record.provenance.finished):
        dataset, method = labels[index]
        item = LabeledRun(str(dataset), str(method), method, unperturbed[index])
        key = (item.dataset, item.method, item.run.record.seed)
        if key in newest:
            superseded.append(newest[key])
        newest[key] = item
    record = runs[0].record
    return Section(
        record.protocol,
        record.scored_on,
        record.repair,
        device,
        tuple(newest.values()),
        tuple(superseded),
        _stability(runs),
    )


def _stability(runs: list[Run]) -> Stability:
    """Of all runs of a section: without perturbed ones there is nothing in it."""
    if all(run.record.perturbation is None for run in runs):
        return Stability([])
    labels = label_runs(runs)
    return Stability(
        LabeledTrialRun(str(dataset), str(method), method, runs[index]) for index, (dataset, method) in labels.items()
    )
