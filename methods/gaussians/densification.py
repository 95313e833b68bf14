"""Adaptive density control: clone, split, prune (3D Gaussian Splatting Sec. 5.2, EnvGS paper Sec. 5.1, App. C)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, Statistics
from envgs_bench.core.vectors import unit

from .parameters import GaussianParameters, RowDraft

Oversized = Literal["split", "prune", "keep"]
PartsWeigh = Literal["share", "most"]
Criterion = Callable[[Statistics, Camera, Tensor], Tensor]  # [N] of a pass, its camera, and means with gradients

SPLIT_PARTS = 2
OVERSIZED_SPLIT_PARTS = 5
SPLIT_DIVISOR = 1.6  # 3DGS's divisor of the scales in a split in two; in five it grows with the area to cover
EXCHANGE_AT_LIMIT = 0.05  # share of a full set that may be replaced at once
UNIMPORTANT_SHARE = 0.1  # an oversized primitive in this least-weighted share is removed, not split


@dataclass(frozen=True)
class DensificationRule:
    """When a primitive is split or removed. Sizes are shares of the scene radius."""

    gradient_threshold: float  # mean criterion above which a primitive is cloned or split
    min_opacity: float  # pruned below
    max_primitives: int  # the least-weighted above this count are pruned; 0: as many as grow
    min_coverage: float = 0.0  # pixels that a primitive must fill, on average over its views, to be cloned or split
    min_views: float = 0.0  # steps that must have shown it for that: `DensificationRecord.effective_views`
    max_growth: float = 0.1  # most that either way of growing adds at once, × the set; 0: any, at the size limit too
    clone_below: float = 0.01  # largest scale up to which a primitive is cloned; above it is split
    oversized_above: float = 0.1  # largest scale above which a primitive is split in five or pruned
    parts_weigh: PartsWeigh = "share"  # what new primitives inherit of a weight, where the least-weighted go

    def of_at_most(self, primitives: int) -> DensificationRule:
        """The rule for a set that may have at most so many; 0: as many as grow."""
        return replace(self, max_primitives=primitives)


class DensificationRecord:
    """Statistics of each primitive over the training steps since the last densification."""

    def __init__(self, primitives: int, device: torch.device) -> None:
        self.gradients = torch.zeros(primitives, device=device)  # Σ of the criterion
        self.steps = torch.zeros(primitives, device=device)  # steps that means are taken over
        self.weights = torch.zeros(primitives, device=device)  # Σ of the blending weight
        self.squares = torch.zeros(primitives, device=device)  # Σ of its square

    def add(self, criterion: Tensor, weights: Tensor, counts: Tensor | None = None) -> None:
        """Add one step.

        Args:
            criterion: [N] the gradient criterion of its pass.
            weights: [N] its blending weights.
            counts: [N] whether the step counts in the means; where None, if there was any weight.
        """
        self.gradients += criterion
        self.steps += weights > 0 if counts is None else counts
        self.weights += weights
        self.squares.addcmul_(weights, weights)

    def keep(self, rows: Tensor) -> None:
        """Keep only the primitives that a mask [N] names."""
        for name, values in vars(self).items():
            setattr(self, name, values[rows])

    def training_state(self) -> dict[str, Tensor]:
        return dict(vars(self))

    def restore_training(self, state: Mapping[str, Tensor]) -> None:
        """Become what `training_state` returned."""
        for name, values in state.items():
            setattr(self, name, values.to(self.gradients.device))

    def mean_gradient(self) -> Tensor:
        return self.gradients / self.steps.clamp_min(1)

    def mean_weight(self) -> Tensor:
        return self.weights / self.steps.clamp_min(1)

    def effective_views(self) -> Tensor:
        """How many steps showed each primitive, [N]: (Σw)² / Σw², which is k for k alike and near 1 where one showed
        far more of it than all others."""
        return self.weights.square() / self.squares.clamp_min(1e-30)


def screen_criterion(statistics: Statistics, camera: Camera, means: Tensor) -> Tensor:
    """3DGS's criterion, [N]: the gradient of the projected center in half image widths and heights.

    A center at depth t moves by f/t pixels a unit, so ∂L/∂x_ndc = W/(2f)·t·∂L/∂x, and alike for y.
    """
    assert statistics.position_gradients is not None
    rows = camera.world_to_camera[:2, :3] / camera.intrinsics.diagonal()[:2, None]
    for row, size in zip(rows, (camera.width, camera.height), strict=True):
        row *= size / 2
    x, y, z = statistics.position_gradients.unbind(dim=1)
    # Written out: a matrix product this narrow takes cuBLAS many times as long.
    moved = ((x * by_x).addcmul_(y, by_y).addcmul_(z, by_z) for by_x, by_y, by_z in rows)
    return torch.hypot(*moved)


def spatial_criterion(statistics: Statistics, camera: Camera, means: Tensor) -> Tensor:
    """The traced set's criterion, [N]: the norm of ½·t·∂L/∂mean summed over hits (EnvGS paper, Sec. 5.1)."""
    assert statistics.position_gradients is not None
    return 0.5 * statistics.position_gradients.norm(dim=1)


def camera_criterion(statistics: Statistics, camera: Camera, means: Tensor) -> Tensor:
    """The same as EnvGS's code has it, [N]: ½·|mean − camera|·|∂L/∂mean|, however far the reflected rays went."""
    assert means.grad is not None
    return 0.5 * (means.detach() - camera.center).norm(dim=1) * means.grad.norm(dim=1)


def densify(
    parameters: GaussianParameters,
    record: DensificationRecord,
    rule: DensificationRule,
    radius: float,
    generator: torch.Generator,
    oversized: Oversized = "split",
) -> DensificationRecord:
    """Clone, split and prune the set, to its size limit; returns the empty record of the new set.

    In this order: small primitives with a large gradient are cloned, large ones split in two (scales ÷ 1.6); those
    below `min_opacity` are pruned; what is `oversized` is treated as that says; and above `max_primitives` those with
    the least mean blending weight go. Parts share their parent's weight, or have it times the largest Σ of weights, so
    that no new one goes (EnvGS's code). With `max_growth`, either way of growing adds at most that share to the
    set, where the gradients or the weights are largest; at the size limit a twentieth, which takes the place of the
    least-weighted. The set changes once, from what it was to what is left: it is never above its size limit.

    Args:
        oversized: "split", in five, or pruned if among the least-weighted tenth (EnvGS); "prune", all of them (3DGS);
            "keep".
    """
    draft = parameters.draft()
    weights = record.mean_weight()
    grows = _growing(record, rule)
    small = _largest_scale(draft) <= rule.clone_below * radius

    most = record.weights.max() if rule.parts_weigh == "most" and len(weights) else None

    clones = torch.nonzero(grows & small)[:, 0]
    draft.append(draft.rows(clones))
    if most is None:
        weights[clones] /= 2
    weights = torch.cat([weights, weights[clones] if most is None else weights[clones] * most])
    splits = functional.pad(grows & ~small, (0, len(clones)))
    weights = _split(draft, weights, splits, SPLIT_PARTS, generator, most)

    opaque = draft.tensors["opacity_logits"].sigmoid() >= rule.min_opacity
    weights = _keep(draft, weights, opaque)

    if oversized != "keep":
        large = _largest_scale(draft) > rule.oversized_above * radius
        if oversized == "prune":
            weights = _keep(draft, weights, ~large)
        elif bool(large.any()):
            weights = _split_oversized(draft, weights, large, rule, generator, most)

    if 0 < rule.max_primitives < len(draft):
        top = torch.topk(weights, rule.max_primitives).indices.sort().values
        _keep(draft, weights, top)
    parameters.become(draft)
    return DensificationRecord(len(parameters), weights.device)


def _growing(record: DensificationRecord, rule: DensificationRule) -> Tensor:
    """Which primitives [N] are cloned or split: those above the threshold; with `max_growth` the largest of them, as
    many as there is room for.

    A blending weight summed over a view's pixels is the number of pixels that the primitive fills. One that fills less
    than `min_coverage` gains nothing by being divided. The depth of one that fewer than `min_views` steps showed is
    hardly constrained: more primitives there would overfit those views and occlude others.
    """
    gradients = record.mean_gradient()
    needed = (gradients >= rule.gradient_threshold) & (record.mean_weight() >= rule.min_coverage)
    known = record.effective_views() >= rule.min_views
    if not rule.max_growth:
        return needed & known
    count = len(gradients)
    room = math.ceil(rule.max_growth * count)
    if rule.max_primitives:
        room = min(room, max(rule.max_primitives - count, math.ceil(EXCHANGE_AT_LIMIT * count)))
    return _largest(needed & known, gradients, room)


def _split_oversized(
    draft: RowDraft,
    weights: Tensor,
    large: Tensor,
    rule: DensificationRule,
    generator: torch.Generator,
    most: Tensor | None,
) -> Tensor:
    """Prune those of the rows `large` [N] that are among the least-weighted, split others in five; the weights."""
    unimportant = large & (weights <= _quantile(weights, UNIMPORTANT_SHARE))
    weights = _keep(draft, weights, ~unimportant)
    large = large[~unimportant]
    if rule.max_growth:
        limit = math.ceil(rule.max_growth / (OVERSIZED_SPLIT_PARTS - 1) * len(large))
        large = _largest(large, weights, limit)
    return _split(draft, weights, large, OVERSIZED_SPLIT_PARTS, generator, most)


def _largest(rows: Tensor, values: Tensor, limit: int) -> Tensor:
    """The mask `rows` [N], reduced to the `limit` rows with the largest values where it has more."""
    if int(rows.sum()) <= limit:
        return rows
    chosen = torch.topk(torch.where(rows, values, -math.inf), limit).indices
    return torch.zeros_like(rows).index_fill(0, chosen, True)


def _largest_scale(draft: RowDraft) -> Tensor:
    return draft.tensors["log_scales"].amax(dim=1).exp()


def _quantile(values: Tensor, share: float) -> Tensor:
    rank = max(1, math.ceil(share * len(values)))
    return values.kthvalue(rank).values


def _keep(draft: RowDraft, weights: Tensor, rows: Tensor) -> Tensor:
    draft.keep(rows)
    return weights[rows]


def _split(
    draft: RowDraft, weights: Tensor, rows: Tensor, parts: int, generator: torch.Generator, most: Tensor | None
) -> Tensor:
    """Replace the masked rows by `parts` smaller ones, drawn from each one's own Gaussian; returns the weights.

    A part's weight is its share of the whole's, or that times `most` where there is one.
    """
    index = torch.nonzero(rows)[:, 0].repeat(parts)
    if not len(index):
        return weights
    new = draft.rows(index)
    new["means"] += drawn_offsets(new, generator)
    new["log_scales"] -= math.log(SPLIT_DIVISOR * math.sqrt(parts / 2))
    draft.append(new)
    weights = torch.cat([weights, weights[index] / parts if most is None else weights[index] * most])
    return _keep(draft, weights, ~functional.pad(rows, (0, len(index))))


def drawn_offsets(tensors: Mapping[str, Tensor], generator: torch.Generator) -> Tensor:
    """From each primitive's center, [N, 3] world frame, to a place drawn from its own Gaussian."""
    scales = tensors["log_scales"].exp()
    offsets = torch.randn(scales.shape, generator=generator).to(scales) * scales
    return _rotated(tensors["quaternions"], functional.pad(offsets, (0, 3 - offsets.shape[1])))


def _rotated(quaternions: Tensor, vectors: Tensor) -> Tensor:
    """Vectors [N, 3] turned by quaternions [N, 4] (wxyz): v + 2w(q × v) + 2q × (q × v)."""
    q = unit(quaternions)
    w, xyz = q[:, :1], q[:, 1:]
    cross = torch.linalg.cross(xyz, vectors)
    return vectors + 2 * (w * cross + torch.linalg.cross(xyz, cross))
