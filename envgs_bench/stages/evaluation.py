"""Evaluation: draw the scored views, keep the pictures, score them, over the full image and inside each region."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Rendering, Scene, View
from envgs_bench.methods.method import Method
from envgs_bench.metrics import Protocol
from envgs_bench.records import MaskedScores, Metrics, ScoredOn, Scores

from .background import Background
from .events import EventListener
from .health import Diverged
from .pictures import depth_unit, save_view
from .pose_alignment import Alignment
from .scoring import FULL, Pair, score_pairs

NORMAL_METRIC = "normal_degrees"


def scored_views(scene: Scene, score_on: ScoredOn) -> Sequence[View]:
    """The views that a run draws, scores and times."""
    return scene.val if score_on == "validation" else scene.test


def evaluate(
    method: Method,
    views: Sequence[View],
    protocol: Protocol,
    folder: Path,
    report: EventListener,
    alignment: Alignment | None = None,
    see: Callable[[View, Rendering], None] | None = None,
) -> tuple[Metrics, dict[str, MaskedScores]]:
    """Scores of `views` and of every region that their masks name.

    Leaves the pictures of `pictures.save_view` in `folder`. Where a view brings exact normals, `normal_degrees` is
    added to its scores: see `normal_error`. Where one does not, `not_computed` says so. With an alignment
    `psnr_aligned` is added. `see` is shown each view with what was drawn of it.

    Raises:
        Diverged: a render is not finite.
    """
    with Background(method.device) as background:
        pairs = _drawn(method, views, folder, report, alignment, background, see)
        metrics, masked = score_pairs(pairs, protocol, method.device)
    without = [view.name for view in views if view.normal is None]
    if without:
        why = f"{len(without)} of {len(views)} scored views bring no exact normals"
        metrics = metrics.model_copy(update={"not_computed": {**metrics.not_computed, NORMAL_METRIC: why}})
    return metrics, masked


def evaluate_unseen(
    method: Method, scene: Scene, protocol: Protocol, folder: Path, report: EventListener
) -> dict[str, Metrics]:
    """Scores of the scene's unseen views, by how they lie to the training cameras. Raises as `evaluate`."""
    return {place: evaluate(method, views, protocol, folder, report)[0] for place, views in scene.unseen.items()}


def _drawn(
    method: Method,
    views: Sequence[View],
    folder: Path,
    report: EventListener,
    alignment: Alignment | None,
    background: Background,
    see: Callable[[View, Rendering], None] | None,
) -> Iterator[Pair]:
    unit = depth_unit([view.camera for view in views])
    for number, view in enumerate(views):
        report({"stage": "scoring", "step": number, "steps": len(views)})
        rendering = method.render(view.camera.to(method.device))
        image = rendering.color.cpu()
        if not torch.isfinite(image).all():
            share = float((~torch.isfinite(image)).float().mean())
            raise Diverged(f"the render of view {view.name} is not finite in {share:.1%} of its values")
        if see:
            see(view, rendering)
        background.begin(save_view, folder, view, rendering, unit)
        others = _normal_errors(view, rendering.normal.cpu())
        if alignment:
            aligned = alignment.scores(method, view)
            others = {region: {**others.get(region, {}), **scores} for region, scores in aligned.items()}
        yield Pair(view.name, image, view.rgb(), view.masks, others)


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


def _normal_errors(view: View, normal: Tensor) -> dict[str, Scores]:
    if view.normal is None:
        return {}
    regions: dict[str, Tensor | None] = {FULL: None, **view.masks}
    return {region: {NORMAL_METRIC: normal_error(normal, view.normal, mask)} for region, mask in regions.items()}
