"""Section: the runs that may share a table, because one protocol scored them and one device timed them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import pandas as pd

from envgs_bench.records import ProtocolName

from .labels import Label, label_runs, method_order
from .published import PROTOCOL, paper_scene
from .runs import Run
from .summary import Numbers, Table, average_table, dataset_table, region_table, with_published
from .tidy import attempts_table, tidy_table

ALL = "all data sets"


@dataclass(frozen=True)
class LabelledRun:
    dataset: str
    method: str
    label: Label  # the method's, with the settings that set it apart
    run: Run


@dataclass(frozen=True)
class Section:
    protocol: ProtocolName
    device: str
    runs: tuple[LabelledRun, ...]
    superseded: tuple[LabelledRun, ...]  # older runs of the same data set, method and seed

    @property
    def title(self) -> str:
        return f"Protocol {self.protocol.name} ({self.protocol.hash}) on {self.device}"

    @property
    def slug(self) -> str:
        """A name for files, of letters, digits and dashes."""
        words = f"{self.protocol.name} {self.protocol.hash[:8]} {self.device}"
        return re.sub(r"[^a-z0-9]+", "-", words.lower()).strip("-")

    def csv_name(self, index: int) -> str:
        """The file of the section's tidy table: the first one's has the plain name."""
        return f"table-{self.slug}.csv" if index else "table.csv"

    @cached_property
    def datasets(self) -> list[str]:
        return sorted({item.dataset for item in self.runs})

    @cached_property
    def methods(self) -> list[str]:
        labels = {item.method: item.label for item in self.runs}
        return sorted(labels, key=lambda method: method_order(labels[method]))

    @cached_property
    def tidy(self) -> pd.DataFrame:
        order = {method: index for index, method in enumerate(self.methods)}
        runs = sorted(self.runs, key=lambda item: (item.dataset, order[item.method], item.run.record.seed))
        return tidy_table([(item.dataset, item.method, item.run) for item in runs])

    @cached_property
    def numbers(self) -> Numbers:
        return Numbers(self.tidy, attempts_table([(item.dataset, item.method, item.run) for item in self.runs]))

    @cached_property
    def tables(self) -> list[Table]:
        return [self._beside_paper(dataset_table(self.numbers, name, self.methods)) for name in self.datasets]

    @cached_property
    def averages(self) -> list[Table]:
        groups = self.families
        return [
            self._beside_paper(average_table(self.numbers, title, datasets, self.methods))
            for title, datasets in groups.items()
        ]

    @cached_property
    def region_tables(self) -> list[Table]:
        found = [region_table(self.numbers, name, self.methods) for name in self.datasets]
        return [table for table in found if table is not None]

    @property
    def all_tables(self) -> list[Table]:
        """In the order of every format: averages, data sets, regions."""
        return [*self.averages, *self.tables, *self.region_tables]

    @property
    def families(self) -> dict[str, list[str]]:
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
        several = {family: members for family, members in groups.items() if len(members) > 1}
        if len(groups) > 1:
            several[ALL] = self.datasets
        return several

    def _beside_paper(self, table: Table) -> Table:
        return with_published(table) if self.protocol.name == PROTOCOL else table

    def of(self, dataset: str) -> list[LabelledRun]:
        """The data set's runs, methods in the tables' order, seeds ascending."""
        order = {method: index for index, method in enumerate(self.methods)}
        runs = [item for item in self.runs if item.dataset == dataset]
        return sorted(runs, key=lambda item: (order[item.method], item.run.record.seed))

    def not_computed(self, dataset: str) -> dict[str, list[str]]:
        """Metric -> the reasons why it is missing from some finished run on the data set."""
        reasons: dict[str, set[str]] = {}
        for item in self.runs:
            if item.dataset == dataset and item.run.record.metrics is not None:
                for metric, why in item.run.record.metrics.not_computed.items():
                    reasons.setdefault(metric, set()).add(why)
        return {metric: sorted(why) for metric, why in sorted(reasons.items())}


def split_sections(runs: Sequence[Run]) -> list[Section]:
    """Sections by protocol (name and hash) and device, the one with most runs first."""
    groups: dict[tuple[str, str, str], list[Run]] = {}
    for run in runs:
        protocol = run.record.protocol
        groups.setdefault((protocol.name, protocol.hash, run.device), []).append(run)
    sections = [_section(group) for group in groups.values()]
    return sorted(sections, key=lambda section: (-len(section.runs), section.title))


def _section(runs: list[Run]) -> Section:
    labels = label_runs(runs)
    newest: dict[tuple[str, str, int], LabelledRun] = {}
    superseded = []
    for index in sorted(range(len(runs)), key=lambda i: runs[i].record.provenance.finished):
        dataset, method = labels[index]
        item = LabelledRun(str(dataset), str(method), method, runs[index])
        key = (item.dataset, item.method, item.run.record.seed)
        if key in newest:
            superseded.append(newest[key])
        newest[key] = item
    return Section(runs[0].record.protocol, runs[0].device, tuple(newest.values()), tuple(superseded))
