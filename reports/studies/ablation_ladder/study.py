"""Ablation ladders, as a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from ...charts.drawn import Canvas
from ...charts.palette import styles
from ...tables.sections import Section
from ...tables.table import Table
from ..study import Drawn, Study
from .ladder import Ladder, ladders
from .page import ladder_data
from .table import KIND, ladder_table

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class AblationLadders(Study):
    """Of each data set the methods whose cards put them on one ladder."""

    name: ClassVar[str] = KIND
    title: ClassVar[str] = "Ablation ladder"

    section: Section
    ladders: tuple[Ladder, ...]

    @classmethod
    def of(cls, section: Section) -> Self | None:
        runs = [(item.dataset, item.label, item.run) for item in section.runs]
        found = ladders(section.numbers, runs, section.cards)
        return cls(section, tuple(found)) if found else None

    def tables(self) -> Sequence[Table]:
        return list(map(ladder_table, self.ladders))

    def csv(self) -> Mapping[str, pd.DataFrame]:
        from .csv_tables import recommendations_table, variants_table

        return {
            self.name: variants_table(self.ladders),
            f"{self.name}-summary": recommendations_table(self.ladders),
        }

    def draw(self, canvas: Canvas, number: int) -> Drawn:
        from .chart import draw_ladders

        style = styles(self.section.methods, self.section.cards)
        return Drawn(tuple(draw_ladders(self.ladders, style, canvas, f"charts/{self.name}-{number}")))

    def page(self, drawn: Drawn) -> Mapping[str, Any]:
        tables = [self.section.with_dropped_losses(table) for table in self.tables()]
        return ladder_data(self.section, self.ladders, tables)
