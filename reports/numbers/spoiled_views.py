"""Spoiled views: what one seed drew far worse than every other, which a mean over views and seeds hides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .runs import Run

SPOILED_BY = 2.0  # dB below the worst of all other seeds
LEAST_SEEDS = 3  # of two, nobody can tell whether one is low or the other high


@dataclass(frozen=True)
class SpoiledView:
    """A view in which `seed` has `psnr` dB, and every other seed at least `others`."""

    view: str
    seed: int
    psnr: float
    others: float


def spoiled_views(runs: Sequence[Run]) -> list[SpoiledView]:
    """Those of one method on one data set, of which `runs` are the seeds; the worst come first."""
    scores = {run.record.seed: run.of_views("psnr") for run in runs if run.ok}
    found = []
    for view in dict.fromkeys(view for of_views in scores.values() for view in of_views):
        by_psnr = sorted((of_views[view], seed) for seed, of_views in scores.items() if view in of_views)
        if len(by_psnr) >= LEAST_SEEDS and by_psnr[0][0] < by_psnr[1][0] - SPOILED_BY:
            found.append(SpoiledView(view, by_psnr[0][1], by_psnr[0][0], by_psnr[1][0]))
    return sorted(found, key=lambda spoiled: spoiled.psnr - spoiled.others)
