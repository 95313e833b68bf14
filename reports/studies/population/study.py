"""The study of a population of scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

from ...kept.tables import PageTable
from ...tables.sections import Section
from ..study import Drawn, Study
from .csv_tables import attributes_table, scenes_table, standings_table
from .failure_map import FailureMap
from .goals import goals, told
from .page_tables import failure_map_told, gaps_told, goals_told, needs_told, standings
from .population import LEVEL_DB, PARTS, Population, population_of
from .sentences import gaps, map_of, needs, shown, where

if TYPE_CHECKING:
    import pandas as pd

    from ...charts.drawn import Canvas


@dataclass(frozen=True)
class PopulationStudy(Study):
    """Scenes that know what they are like: who is best on how many, by how much, and where who fails."""

    name: ClassVar[str] = "population"
    title: ClassVar[str] = "Population of scenes"
    page_tables: ClassVar[Mapping[str, PageTable]] = {
        "goals": goals_told,
        "standings": standings,
        "failure_map": failure_map_told,
        "needs": needs_told,
        "gaps": gaps_told,
    }

    section: Section
    found: Population

    @classmethod
    def of(cls, section: Section) -> Self | None:
        found = population_of(section)
        return None if found is None else cls(section, found)

    @cached_property
    def mapped(self) -> FailureMap:
        return map_of(self.found)

    def csv(self) -> Mapping[str, pd.DataFrame]:
        return {
            self.name: scenes_table(self.found),
            f"{self.name}-standings": standings_table(self.found),
            f"{self.name}-attributes": attributes_table(self.found, self.mapped),
        }

    def draw(self, canvas: Canvas, number: int) -> Drawn:
        from .chart import draw_population

        folder = f"charts/{self.name}-{number}"
        return Drawn(tuple(draw_population(self.section, self.found, self.mapped, canvas, folder)))

    def page(self, drawn: Drawn) -> Mapping[str, Any]:
        found, mapped = self.found, self.mapped
        parts = [""] if len(found.used_parts) < 2 else found.used_parts
        return {
            "goals": told(goals(found, mapped)),
            "scenes": len(found.psnr),
            "left_out": len(found.attributes) - len(found.psnr),
            "level": f"{LEVEL_DB:g} dB",
            "tables": [
                {
                    "title": f"{len(found.scenes(part))} scenes" + (f" for {part} ({PARTS[part]})" if part else ""),
                    "rows": [shown(found.standing(method, part)) for method in found.psnr.columns],
                }
                for part in parts
            ],
            "subject": found.subject,
            "where": where(found, mapped),
            "gaps": gaps(found),
            "needs": needs(found),
        }
