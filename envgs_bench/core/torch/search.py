"""Which hits are blended: every ray against every primitive, or chosen candidates, without gradients."""

from __future__ import annotations

from dataclasses import dataclass
from math import prod

import torch
from torch import Tensor

from .intersections import Intersector, alphas, cutoffs

PAIRS_AT_ONCE = 1 << 20  # bounds the memory of a brute-force search


@dataclass(frozen=True)
class BlendedHits:
    """Pairs of a ray and a primitive, sorted by ray and within a ray front to back."""

    rays: Tensor  # [P] int64
    primitives: Tensor  # [P] int64


def all_blended_hits(intersector: Intersector, transmittance_min: Tensor | float) -> BlendedHits:
    """The blended hits of all rays, by testing each against all primitives."""
    device = intersector.gaussians.device
    primitives = torch.arange(len(intersector.gaussians), device=device)
    rays_at_once = max(1, PAIRS_AT_ONCE // max(1, len(primitives)))
    found = [BlendedHits(primitives[:0], primitives[:0])]
    for rays in torch.arange(prod(intersector.shape), device=device).split(rays_at_once):
        found.append(blended_hits(intersector, rays[:, None], primitives[None, :], transmittance_min))
    return BlendedHits(torch.cat([f.rays for f in found]), torch.cat([f.primitives for f in found]))


@torch.no_grad()
def blended_hits(
    intersector: Intersector, rays: Tensor, primitives: Tensor, transmittance_min: Tensor | float
) -> BlendedHits:
    """The blended hits among candidate pairs, given as indices of shapes that broadcast.

    Args:
        transmittance_min: of all rays, or [R] of each.
    """
    opacities = intersector.gaussians.opacities
    intersections = intersector.intersect(rays, primitives, intersector.gaussians.means[primitives])
    drawn = intersections.valid & (intersections.rho <= cutoffs(opacities)[primitives])
    rays, primitives = (index.expand_as(drawn)[drawn] for index in (rays, primitives))
    alpha = alphas(opacities[primitives], intersections.rho[drawn])

    order = front_to_back(rays, intersections.order[drawn], primitives)
    rays, primitives, alpha = rays[order], primitives[order], alpha[order]
    # The hit that takes the transmittance below the threshold is the last one blended.
    ends = transmittance_min[rays] if isinstance(transmittance_min, Tensor) else transmittance_min
    kept = transmittances(rays, alpha) >= ends
    return BlendedHits(rays[kept], primitives[kept])


def front_to_back(rays: Tensor, order: Tensor, primitives: Tensor) -> Tensor:
    """The permutation that sorts by ray, then by order, then by index."""
    permutation = primitives.argsort(stable=True)
    permutation = permutation[order[permutation].argsort(stable=True)]
    return permutation[rays[permutation].argsort(stable=True)]


def transmittances(rays: Tensor, alpha: Tensor) -> Tensor:
    """The transmittance in front of each hit, Π over the ray's earlier hits of (1 − α); hits are sorted by ray."""
    if len(rays) == 0:
        return torch.ones_like(alpha)
    _, row, counts = rays.unique_consecutive(return_inverse=True, return_counts=True)
    column = torch.arange(len(rays), device=rays.device) - (counts.cumsum(0) - counts)[row]
    passed = alpha.new_ones(len(counts), int(counts.max()) + 1).index_put((row, column + 1), 1 - alpha)
    return passed.cumprod(dim=1)[row, column]
