"""Scoring: pictures and their targets to a record's numbers, over the full image and inside each region."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from envgs_bench.metrics import Protocol
from envgs_bench.records import MaskedScores, Metrics, Scores, ViewScores

FULL = "full"


@dataclass(frozen=True)
class Pair:
    """One test view: a prediction beside its target."""

    view: str
    prediction: Tensor  # [H, W, 3] floats, sRGB
    target: Tensor  # [H, W, 3] floats in [0, 1]
    masks: Mapping[str, Tensor]  # region -> [H, W] bool
    others: Mapping[str, Scores] = field(default_factory=dict)  # region or FULL -> scores that no protocol computes


def score_pairs(
    pairs: Iterable[Pair], protocol: Protocol, device: torch.device | str = "cpu"
) -> tuple[Metrics, dict[str, MaskedScores]]:
    """Scores of all views and of every region that their masks name; a view that does not show a region leaves it out.

    Pairs are taken one at a time, so that they need not lie in memory together. LPIPS is computed on `device`.
    """
    full: list[ViewScores] = []
    regions: dict[str, list[ViewScores]] = {}
    for pair in pairs:
        masks = {region: mask for region, mask in pair.masks.items() if mask.any()}
        whole, *parts = _scored(pair, [None, *masks.values()], protocol, device)
        full.append(_scores(pair, FULL, whole))
        for region, scores in zip(masks, parts, strict=True):
            regions.setdefault(region, []).append(_scores(pair, region, scores))
    metrics = Metrics(
        mean=_means(full),
        per_view=full,
        not_computed=protocol.not_computed,
        cards=protocol.cards,
        weights=protocol.weights,
    )
    masked = {
        region: MaskedScores.model_validate({"per_view": per_view, **_means(per_view)})
        for region, per_view in regions.items()
    }
    return metrics, masked


def _scored(
    pair: Pair, masks: Sequence[Tensor | None], protocol: Protocol, device: torch.device | str
) -> list[dict[str, float | None]]:
    def on(place: torch.device | str) -> list[dict[str, float | None]]:
        regions = [None if mask is None else mask.to(place) for mask in masks]
        return protocol.scores(pair.prediction.to(place), pair.target.to(place), regions)

    try:  # the network's features take 1.5 kB a pixel, beside a model that may fill the device
        return on(device)
    except torch.OutOfMemoryError:
        return on("cpu")


def _scores(pair: Pair, region: str, scores: Scores) -> ViewScores:
    return ViewScores.model_validate({"view": pair.view, **scores, **pair.others.get(region, {})})


def _means(views: Iterable[ViewScores]) -> Scores:
    """The unweighted mean over views of each metric, None where a view's could not be computed."""
    columns: dict[str, list[float | None]] = {}
    for view in views:
        for name, value in view.scores.items():
            columns.setdefault(name, []).append(value)
    return {name: _mean(values) for name, values in columns.items()}


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if len(known) == len(values) else None
