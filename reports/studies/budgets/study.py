"""Budgets: quality against the primitives that models had, where that bends, and base against environment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from ...charts.drawn import Canvas
from ...numbers.comparison import FEWEST_SEEDS
from ...tables.sections import Section
from ..study import Drawn, Study
from .budgets import TIED_DB, BudgetCurve, BudgetMap, budget_curves, budget_maps
from .sentences import curve_sentence, map_sentence, rate_sentence

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class BudgetStudy(Study):
    """Rows that differ in what their models may have alone."""

    name: ClassVar[str] = "budgets"
    title: ClassVar[str] = "Budgets"

    section: Section
    curves: tuple[BudgetCurve, ...]
    maps: tuple[BudgetMap, ...]

    @classmethod
    def of(cls, section: Section) -> Self | None:
        labels = {row: section.labels[row] for row in section.methods}
        curves = budget_curves(section.datasets, labels, section.numbers)
        maps = budget_maps(section.datasets, labels, section.numbers)
        return cls(section, tuple(curves), tuple(maps)) if curves or maps else None

    def csv(self) -> Mapping[str, pd.DataFrame]:
        from .csv_tables import budgets_table

        return {self.name: budgets_table(self.curves, self.maps)}

    def draw(self, canvas: Canvas, number: int) -> Drawn:
        from .chart import draw_budgets

        charts = draw_budgets(self.section, self.curves, self.maps, canvas, f"charts/{self.name}-{number}")
        return Drawn(tuple(charts))

    def page(self, drawn: Drawn) -> Mapping[str, Any]:
        datasets = []
        for dataset in self.section.datasets:
            curves = [curve for curve in self.curves if curve.dataset == dataset]
            sentences = [curve_sentence(curve) for curve in curves]
            sentences += [words for curve in curves if (words := rate_sentence(curve, curves))]
            sentences += [map_sentence(found) for found in self.maps if found.dataset == dataset]
            if sentences:
                datasets.append({"name": dataset, "sentences": sentences})
        return {
            "datasets": datasets,
            "tied": f"{TIED_DB:g} dB",
            "seeds": FEWEST_SEEDS,
            "with_map": bool(self.maps),
        }
