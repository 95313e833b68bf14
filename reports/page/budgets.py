"""The page's part on budgets: sentences, curves and maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..charts.drawn import TitledChart
from ..numbers.budgets import TIED_DB
from ..numbers.statistics import FEWEST_SEEDS
from ..tables.budgets import Budgets, curve_sentence, map_sentence
from ..tables.sections import Section


@dataclass(frozen=True)
class BudgetPart:
    """What was found and drawn for a section."""

    budgets: Budgets
    charts: tuple[TitledChart, ...]


def budget_data(section: Section, index: int, part: BudgetPart | None) -> dict[str, Any] | None:
    """What the template shows, as plain values; None where nothing has budgets."""
    if part is None:
        return None
    datasets = []
    for dataset in section.datasets:
        sentences = [curve_sentence(curve) for curve in part.budgets.curves if curve.dataset == dataset]
        sentences += [map_sentence(found) for found in part.budgets.maps if found.dataset == dataset]
        if sentences:
            datasets.append({"name": dataset, "sentences": sentences})
    return {
        "datasets": datasets,
        "charts": part.charts,
        "csv": section.csv_name(index, "budgets"),
        "tied": f"{TIED_DB:g} dB",
        "seeds": FEWEST_SEEDS,
        "with_map": bool(part.budgets.maps),
    }
