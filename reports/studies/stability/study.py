"""Stability under perturbations, as a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from ...charts.drawn import Canvas
from ...charts.palette import styles
from ...tables.sections import Section
from ...tables.table import Table
from ..study import Drawn, Study
from .page import stability_data
from .stability import Stability
from .table import KIND, stability_tables

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class StabilityStudy(Study):
    """Of perturbed runs, which are in nothing else, each beside its unperturbed partner."""

    name: ClassVar[str] = KIND
    title: ClassVar[str] = "Stability"

    section: Section
    stability: Stability

    @classmethod
    def of(cls, section: Section) -> Self | None:
        return cls(section, Stability(section.with_perturbed)) if section.with_perturbed else None

    def tables(self) -> Sequence[Table]:
        return stability_tables(self.stability)

    def csv(self) -> Mapping[str, pd.DataFrame]:
        from .csv_tables import cells_table, summary_table

        return {self.name: cells_table(self.stability), f"{self.name}-summary": summary_table(self.stability)}

    def draw(self, canvas: Canvas, number: int) -> Drawn:
        from .chart import draw_stability
        from .worst_views import draw_worst_views

        place = f"{self.name}-{number}"
        rows = list(dict.fromkeys([*self.section.methods, *self.stability.methods]))
        charts = draw_stability(self.stability, styles(rows, self.section.cards), canvas, f"charts/{place}")
        return Drawn(tuple(charts), tuple(draw_worst_views(self.stability, canvas.out, f"pictures/{place}")))

    def page(self, drawn: Drawn) -> Mapping[str, Any]:
        return stability_data(self.section, self.stability, self.tables())
