"""Differences to the best, as a study of test views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from ...tables.sections import Section
from ...tables.table import Table
from ..study import Study
from .differences import Differences, differences
from .table import KIND, difference_tables


@dataclass(frozen=True)
class DifferencesToBest(Study):
    """Of test views alone: what is ahead on validation views, candidates say."""

    name: ClassVar[str] = KIND
    title: ClassVar[str] = "Differences to the best"
    first: ClassVar[bool] = True

    found: Differences

    @classmethod
    def of(cls, section: Section) -> Self | None:
        found = differences(section.numbers, section.datasets, section.methods) if section.scored_on == "test" else None
        return cls(found) if found is not None else None

    def tables(self) -> Sequence[Table]:
        return difference_tables(self.found)
