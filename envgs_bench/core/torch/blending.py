"""Blending: color, alpha, depth, normal and extras of each ray from its hits, with gradients."""

from __future__ import annotations

from math import prod
from typing import Any

import torch
from torch import Tensor

from ..rendering import Rendering, Statistics
from .intersections import Intersections, Intersector, alphas
from .search import BlendedHits, transmittances


def blend_hits(
    intersector: Intersector,
    hits: BlendedHits,
    background: Tensor,
    low_pass_statistics: bool = True,
    color_statistics: bool = False,
    removals: bool = False,
) -> Rendering:
    """Blend the hits of each ray front to back; the rendering's fields have the shape of its rays."""
    gaussians, rays, primitives = intersector.gaussians, hits.rays, hits.primitives

    def intersected() -> tuple[Tensor, Intersections, Tensor]:
        """A copy of the means for each hit, so that a backward pass leaves the gradient of each; hits and weights."""
        means = gaussians.means[primitives]
        intersections = intersector.intersect(rays, primitives, means)
        opacities = gaussians.opacities[primitives]
        alpha = alphas(opacities.detach() if removals else opacities, intersections.rho)
        if removals:
            alpha = RemovalSquares.apply(alpha, opacities)
        return means, intersections, transmittances(rays, alpha) * alpha

    def blend(values: Tensor, weights: Tensor) -> Tensor:
        """Σ w·value of each ray, from one value [P, …] a hit."""
        weighted = weights.reshape(-1, *[1] * (values.ndim - 1)) * values
        sums = values.new_zeros(prod(intersector.shape), *values.shape[1:]).index_add(0, rays, weighted)
        return sums.reshape(*intersector.shape, *values.shape[1:])

    means, intersections, weights = intersected()
    means_of_color, _, color_weights = intersected() if color_statistics else (means, None, weights)
    ones = torch.ones_like(weights)
    total = blend(ones, weights)
    extras = gaussians.means.new_zeros(len(gaussians), 0) if gaussians.extras is None else gaussians.extras
    counts = torch.bincount(rays, minlength=prod(intersector.shape))
    weight_sums = weights.new_zeros(len(gaussians)).index_add(0, primitives, weights.detach())
    rendering = Rendering(
        color=blend(intersector.colors(rays, primitives), color_weights)
        + (1 - blend(ones, color_weights))[..., None] * background,
        alpha=total,
        depth=blend(intersections.t, weights) / torch.where(total > 0, total, 1),
        normal=blend(intersector.axes[primitives] * intersections.facing[:, None], weights),
        extras=blend(extras[primitives], weights),
        hits=counts.reshape(intersector.shape).to(torch.int32),
        statistics=Statistics(weights=weight_sums),
    )
    if means.requires_grad:
        t = intersections.t.detach()
        if not low_pass_statistics and intersections.low_pass is not None:
            t = torch.where(intersections.low_pass, 0, t)
        record_position_gradients(rendering.statistics, means_of_color, primitives, t, len(gaussians))
    return rendering


def record_position_gradients(statistics: Statistics, means: Tensor, primitives: Tensor, t: Tensor, count: int) -> None:
    """Have the backward pass leave Σ over hits of t·∂L/∂mean in the statistics.

    The hits' means feed their geometry alone (where they are hit, at which depth); the direction that SH color is
    looked up in takes the set's own means and has no part in it.
    """

    def leave(gradient: Tensor) -> None:
        weighted = t[:, None] * gradient
        statistics.position_gradients = gradient.new_zeros(count, 3).index_add(0, primitives, weighted)

    means.register_hook(leave)


class RemovalSquares(torch.autograd.Function):
    """The alphas [P] of hits as they are; the gradient of their opacities [P] is (α·∂L/∂α)², see `removals.py`."""

    @staticmethod
    def forward(ctx: Any, alpha: Tensor, opacities: Tensor) -> Tensor:
        ctx.save_for_backward(alpha)
        return alpha.clone()

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor]:
        (alpha,) = ctx.saved_tensors
        return gradient, (alpha * gradient).square()
