"""Evaluation: draw the test views, keep the pictures, score them, over the full image and inside each region."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from .core import Rendering, View
from .methods.method import Method
from .metrics import Protocol
from .records import MaskedScores, Metrics, Scores, ViewScores
from .training import Diverged, Report
from .view_pictures import depth_unit, save_view

NORMAL_METRIC = "normal_degrees"


def evaluate(
    method: Method, views: Sequence[View], protocol: Protocol, folder: Path, report: Report
) -> tuple[Metrics, dict[str, MaskedScores]]:
    """Scores of `views` and of every region that their masks name.

    Leaves the pictures of `view_pictures.save_view` in `folder`. Where a view brings exact normals, `normal_degrees` is
    added to its scores: see `normal_error`.

    Raises:
        Diverged: a render is not finite.
    """
    full: list[ViewScores] = []
    regions: dict[str, list[ViewScores]] = {}
    unit = depth_unit([view.camera for view in views])
    for number, view in enumerate(views):
        report({"stage": "scoring", "step": number, "steps": len(views)})
        rendering = method.render(view.camera.to(method.device))
        image, target = rendering.color.cpu(), view.rgb()
        if not torch.isfinite(image).all():
            share = float((~torch.isfinite(image)).float().mean())
            raise Diverged(f"the render of test view {view.name} is not finite in {share:.1%} of its values")
        save_view(folder, view, rendering, unit)
        full.append(_scores(view, protocol.score(image, target), rendering, None))
        for region, mask in view.masks.items():
            if mask.any():
                scores = _scores(view, protocol.score(image, target, mask), rendering, mask)
                regions.setdefault(region, []).append(scores)
    metrics = Metrics(mean=_means(full), per_view=full, not_computed=dict(protocol.not_computed))
    masked = {
        region: MaskedScores.model_validate({"per_view": per_view, **_means(per_view)})
        for region, per_view in regions.items()
    }
    return metrics, masked


def normal_error(normal: Tensor, reference: Tensor, mask: Tensor | None = None) -> float | None:
    """Mean angle between rendered and exact normals over the pixels with an exact one, degrees.

    Args:
        normal: [H, W, 3] blended normals of any length; where nothing was drawn (length 0) the angle counts as 90°.
        reference: [H, W, 3] unit normals in the same frame, 0 where unknown.
        mask: [H, W] bool, the pixels that count; all where None.

    Returns:
        None where no pixel counts.
    """
    known = reference.norm(dim=-1) > 0.5
    known = known if mask is None else known & mask
    if not known.any():
        return None
    cosine = (functional.normalize(normal[known].double(), dim=-1) * reference[known].double()).sum(-1)
    return float(torch.rad2deg(torch.acos(cosine.clamp(-1, 1))).mean())


def _scores(view: View, scores: Mapping[str, float | None], rendering: Rendering, mask: Tensor | None) -> ViewScores:
    row: Scores = dict(scores)
    if view.normal is not None:
        row[NORMAL_METRIC] = normal_error(rendering.normal.cpu(), view.normal, mask)
    return ViewScores.model_validate({"view": view.name, **row})


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
