"""Population: many scenes of one distribution, each with its attributes, and what methods score on them.

A scene counts once: its runs' seeds are averaged. Differences are paired by scene, and their intervals are of the
distribution that scenes are drawn from, not of these scenes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import pandas as pd

from ...numbers.intervals import Interval, sample_interval, share_interval
from ...tables.sections import Section

FEWEST_SCENES = 8
CHOOSING = 32  # scenes of a smaller seed are for choosing settings, others for judging them
LEVEL_DB = 0.1  # behind by no more is level
PARTS = {"choosing": f"seeds below {CHOOSING}", "judging": f"seeds from {CHOOSING}"}
METRICS = ("psnr", "frame_ms", "train_seconds", "primitives", "model_bytes")


@dataclass(frozen=True)
class Standing:
    """One method among the others on the scenes that all of them finished."""

    method: str
    scenes: int
    best: int  # on how many of them it is the best
    best_share: Interval
    margin: float  # mean of its PSNR less the best other's, dB
    margin_interval: Interval | None
    level: float  # share of the scenes on which it is behind the best other by LEVEL_DB at most
    worst: float  # its largest margin behind the best other, dB: negative where it is ever behind
    failed: int  # runs without status ok, on all scenes


@dataclass(frozen=True)
class Population:
    """Scenes by row.

    Attributes:
        attributes: a column an attribute, the scene's name as index.
        parts: scene -> a key of PARTS.
        scores: metric -> a column a method, NaN where it did not finish.
        failures: method -> how many of its runs did not end with status ok.
        subject: the method whose failures are mapped.
        ladder: the methods of its ablation ladder, from the baseline up; () where there is none.
    """

    attributes: pd.DataFrame
    parts: pd.Series
    scores: dict[str, pd.DataFrame]
    failures: dict[str, int]
    subject: str
    ladder: tuple[str, ...]

    @cached_property
    def psnr(self) -> pd.DataFrame:
        """Of the scenes that all methods finished."""
        return self.scores["psnr"].dropna()

    def scenes(self, part: str = "") -> pd.Index:
        """Of `psnr`, those of a part, or all."""
        return self.psnr.index if not part else self.psnr.index[self.parts[self.psnr.index] == part]

    @property
    def used_parts(self) -> list[str]:
        return [part for part in PARTS if len(self.scenes(part)) >= FEWEST_SCENES]

    def margins(self, method: str, part: str = "") -> pd.Series:
        """The method's PSNR less the best other method's, dB, a scene."""
        psnr = self.psnr.loc[self.scenes(part)]
        return psnr[method] - psnr.drop(columns=method).max(axis=1)

    def standing(self, method: str, part: str = "") -> Standing:
        margins = self.margins(method, part)
        best = int((margins > 0).sum())
        return Standing(
            method,
            len(margins),
            best,
            share_interval(best, len(margins)),
            float(margins.mean()),
            sample_interval(margins.to_numpy()),
            float((margins >= -LEVEL_DB).mean()),
            float(margins.min()),
            self.failures.get(method, 0),
        )

    def gap(self, method: str) -> tuple[float, Interval | None] | None:
        """By how much its mean margin is better on the scenes for choosing than on others; None without both."""
        if len(self.used_parts) < 2:
            return None
        ours, theirs = (self.margins(method, part).to_numpy() for part in PARTS)
        return float(ours.mean() - theirs.mean()), sample_interval(ours, theirs)

    def enough(self, scene: str) -> tuple[str, str]:
        """The first variant of the ladder, and the method of the fewest primitives, within LEVEL_DB of the best."""
        psnr = self.psnr.loc[scene]
        near = [method for method in self.ladder if psnr[method] >= psnr[list(self.ladder)].max() - LEVEL_DB]
        sizes = self.scores["primitives"].loc[scene]
        small = [method for method in psnr.index if psnr[method] >= psnr.max() - LEVEL_DB]
        return (near[0] if near else ""), min(small, key=lambda method: sizes[method])


def population_of(section: Section) -> Population | None:
    """The population of a section's runs; None of fewer than FEWEST_SCENES scenes, or of one method."""
    about = {item.dataset: item.run.record for item in section.runs if item.run.record.attributes}
    if len(about) < FEWEST_SCENES or section.scored_on != "test":
        return None
    tidy = section.tidy[section.tidy["dataset"].isin(list(about)) & (section.tidy["region"] == "full")]
    tables = {metric: _table(tidy, metric, section.methods) for metric in METRICS}
    psnr = tables["psnr"]
    if psnr.shape[1] < 2 or len(psnr.dropna()) < FEWEST_SCENES:
        return None
    attributes = pd.DataFrame({name: record.attributes for name, record in about.items()}).T
    seeds = {name: int(record.config.get("dataset", {}).get("seed", CHOOSING)) for name, record in about.items()}
    parts = pd.Series({name: part_of(seed) for name, seed in seeds.items()})
    ladder = tuple(_ladder(section, list(psnr.columns)))
    means = psnr.dropna().mean()
    subject = ladder[-1] if len(ladder) > 1 else str(means.idxmax())
    return Population(attributes, parts, tables, _failures(section, set(about)), subject, ladder)


def part_of(seed: int) -> str:
    """A key of PARTS, by a scene's seed."""
    return "choosing" if seed < CHOOSING else "judging"


def _table(tidy: pd.DataFrame, metric: str, methods: list[str]) -> pd.DataFrame:
    """The mean over seeds, a row a scene and a column a method, those in the tables' order."""
    own = tidy[tidy["metric"] == metric]
    table = own.pivot_table(index="dataset", columns="method", values="value", aggfunc="mean")
    return table[[method for method in methods if method in table]]


def _ladder(section: Section, methods: list[str]) -> Iterator[str]:
    """The methods on the ladder that most of them are on, from the baseline up."""
    cards = {method: section.card(method) for method in section.methods if method in methods}
    names = [card.ladder for card in cards.values() if card.ladder]
    if names:
        name = max(names, key=names.count)
        yield from sorted((m for m, card in cards.items() if card.ladder == name), key=lambda m: cards[m].step)


def _failures(section: Section, scenes: set[str]) -> dict[str, int]:
    found: dict[str, int] = {}
    for item in section.runs:
        if item.dataset in scenes:
            found[item.method] = found.get(item.method, 0) + (not item.run.ok)
    return found
