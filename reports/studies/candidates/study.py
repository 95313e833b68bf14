"""Candidates for settings, as a study of validation views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from ...tables.sections import Section
from ...tables.table import Table
from ..study import Study
from .candidates import Candidates, candidates_of
from .table import KIND, candidates_table


@dataclass(frozen=True)
class CandidateStudy(Study):
    """Of validation views alone: settings are not chosen on test views."""

    name: ClassVar[str] = KIND
    title: ClassVar[str] = "Candidates"
    first: ClassVar[bool] = True

    found: tuple[Candidates, ...]

    @classmethod
    def of(cls, section: Section) -> Self | None:
        if section.scored_on == "test":
            return None
        found = candidates_of(section.numbers, [(item.dataset, item.label, item.run) for item in section.runs])
        return cls(tuple(found)) if found else None

    def tables(self) -> Sequence[Table]:
        return [candidates_table(found) for found in self.found]
