"""The study of a population of scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

from ...numbers.intervals import Interval
from ...tables.sections import Section
from ..study import Drawn, Study
from .failure_map import FailureMap, failure_map, sentences
from .population import LEVEL_DB, PARTS, Population, Standing, population_of, standings_table, tidy_population

if TYPE_CHECKING:
    import pandas as pd

    from ...charts.drawn import Canvas


@dataclass(frozen=True)
class PopulationStudy(Study):
    """Scenes that know what they are like: who is best on how many, by how much, and where who fails."""

    name: ClassVar[str] = "population"
    title: ClassVar[str] = "Population of scenes"

    section: Section
    found: Population

    @classmethod
    def of(cls, section: Section) -> Self | None:
        found = population_of(section)
        return None if found is None else cls(section, found)

    @cached_property
    def mapped(self) -> FailureMap:
        margins = self.found.margins(self.found.subject)
        return failure_map(self.found.attributes.loc[margins.index], margins)

    def csv(self) -> Mapping[str, pd.DataFrame]:
        return {self.name: tidy_population(self.found), f"{self.name}-standings": standings_table(self.found)}

    def draw(self, canvas: Canvas, number: int) -> Drawn:
        from .chart import draw_population

        folder = f"charts/{self.name}-{number}"
        return Drawn(tuple(draw_population(self.section, self.found, self.mapped, canvas, folder)))

    def page(self, drawn: Drawn) -> Mapping[str, Any]:
        found, mapped = self.found, self.mapped
        parts = [""] if len(found.used_parts) < 2 else found.used_parts
        return {
            "scenes": len(found.psnr),
            "left_out": len(found.attributes) - len(found.psnr),
            "level": f"{LEVEL_DB:g} dB",
            "tables": [
                {
                    "title": f"{len(found.scenes(part))} scenes" + (f" for {part} ({PARTS[part]})" if part else ""),
                    "rows": [_row(found.standing(method, part)) for method in found.psnr.columns],
                }
                for part in parts
            ],
            "subject": found.subject,
            "leaves": list(sentences(mapped.tree, found.subject, "the best other method", LEVEL_DB)),
            "signs": f"{100 * mapped.signs:.0f} %",
            "majority": f"{100 * mapped.majority:.0f} %",
            "explained": f"{100 * max(mapped.explained, 0):.0f} %",
            "gaps": list(self._gaps()),
            "enough": self._enough(),
        }

    def _gaps(self) -> list[str]:
        """What choosing on the scenes for choosing has flattered."""
        pairs = ((method, self.found.gap(method)) for method in self.found.psnr.columns)
        return [
            f"{method}: {gap[0]:+.2f} dB{_interval(gap[1])} better on scenes for choosing than on those for judging."
            for method, gap in pairs
            if gap is not None
        ]

    def _enough(self) -> list[str]:
        """On which share of the scenes each variant of the ladder, and each method as the smallest, is enough."""
        pairs = [self.found.enough(scene) for scene in self.found.psnr.index]
        said = []
        for method in self.found.ladder if len(self.found.ladder) > 1 else ():
            share = sum(pair[0] == method for pair in pairs) / len(pairs)
            said.append(f"{method} is the first variant that is enough on {100 * share:.0f} % of the scenes.")
        for method in self.found.psnr.columns:
            share = sum(pair[1] == method for pair in pairs) / len(pairs)
            if share:
                said.append(f"{method} is the smallest model that is enough on {100 * share:.0f} % of the scenes.")
        if len(self.found.ladder) > 1:
            said += sentences(self._gain().tree, self.found.ladder[-1], self.found.ladder[0], LEVEL_DB)
        return said

    def _gain(self) -> FailureMap:
        """Of the top of the ladder over its baseline: which scenes need what is between."""
        psnr = self.found.psnr
        gain = psnr[self.found.ladder[-1]] - psnr[self.found.ladder[0]]
        return failure_map(self.found.attributes.loc[psnr.index], gain)


def _row(one: Standing) -> dict[str, str]:
    return {
        "method": one.method,
        "best": f"{100 * one.best / one.scenes:.0f} % ({100 * one.best_share[0]:.0f} to {100 * one.best_share[1]:.0f})",
        "margin": f"{one.margin:+.2f}{_interval(one.margin_interval)}",
        "level": f"{100 * one.level:.0f} %",
        "worst": f"{one.worst:+.2f}",
        "failed": str(one.failed),
    }


def _interval(interval: Interval | None) -> str:
    return "" if interval is None else f" ({interval[0]:+.2f} to {interval[1]:+.2f})"
