"""Chapter: a section with all of its tables, those of studies among them, as every format shows it."""

from __future__ import annotations

from dataclasses import dataclass

from .layouts import LAYOUTS
from .sections import Section
from .table import Table


@dataclass(frozen=True)
class TableGroup:
    """The tables of one kind.

    Attributes:
        unfolded: whether a page shows them at once.
        elsewhere: whether a part of the page of its own shows them, as some studies' does.
    """

    kind: str
    title: str
    tables: tuple[Table, ...]
    unfolded: bool = False
    elsewhere: bool = False


@dataclass(frozen=True)
class Chapter:
    """A section and the groups of its tables, in the order of every format."""

    section: Section
    groups: tuple[TableGroup, ...]

    @property
    def tables(self) -> list[Table]:
        return [table for group in self.groups for table in group.tables]


def ordinary_groups(section: Section) -> list[TableGroup]:
    """The section's own tables, by kind."""
    found = []
    for kind, layout in LAYOUTS.items():
        tables = tuple(table for table in section.tables if table.kind == kind)
        if tables:
            found.append(TableGroup(kind, layout.title, tables, layout.unfolded))
    return found
