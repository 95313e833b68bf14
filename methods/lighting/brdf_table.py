"""The split-sum approximation's table: what share of a uniform environment a rough surface reflects.

    ∫ f(l, v)·(n·l) dl = F₀·scale + bias

for the microfacet BRDF f = D·F·G / (4·(n·l)·(n·v)) with GGX's D of α = roughness², Schlick's F, and Smith's G of GGX
for heights that are correlated (Karis, Real Shading in Unreal Engine 4, 2013; Heitz, Understanding the
Masking-Shadowing Function in Microfacet-Based BRDFs, 2014, Eq. 99).
"""

from __future__ import annotations

import math
from functools import cache

import torch
from torch import Tensor

from .texels import texel_below

SIZE = 32  # nodes along each axis, from 0 to 1
LEAST_COSINE = 1e-3  # of the table's first column: at 0 exactly nothing is defined
LEAST_ROUGHNESS = 1e-2
ELEVATIONS, AZIMUTHS = 64, 24  # of the microfacets' normals that a node is summed over


@cache
def brdf_table(device: torch.device | str = "cpu") -> Tensor:
    """Scale and bias [SIZE, SIZE, 2] at n·v of the row and roughness of the column, from 0 to 1."""
    nodes = torch.linspace(0, 1, SIZE, dtype=torch.float64)
    cosine = nodes.clamp_min(LEAST_COSINE)[:, None, None, None]
    alpha = nodes.clamp_min(LEAST_ROUGHNESS)[:, None, None].square()
    share = ((torch.arange(ELEVATIONS, dtype=torch.float64) + 0.5) / ELEVATIONS)[:, None]
    azimuth = (torch.arange(AZIMUTHS, dtype=torch.float64) + 0.5) * (math.pi / AZIMUTHS)  # the other half mirrors it

    # Microfacet normals h in proportion to D·(n·h), about n = z; v lies in the plane y = 0.
    n_h = ((1 - share) / (1 + (alpha.square() - 1) * share)).sqrt()
    v_h = (1 - cosine.square()).sqrt() * (1 - n_h.square()).sqrt() * azimuth.cos() + cosine * n_h
    n_l = 2 * v_h * n_h - cosine
    lit = (n_l > 0) & (v_h > 0)
    upward = n_l.clamp_min(0)
    shadowed, masked = (cosine * _slanted(upward, alpha), upward * _slanted(cosine, alpha))
    geometry = 2 * upward / (shadowed + masked)  # G / (n·v)
    weight = torch.where(lit, geometry * v_h / n_h, 0.0)
    fresnel = (1 - v_h.clamp(0, 1)) ** 5
    table = torch.stack([(weight * (1 - fresnel)).mean((2, 3)), (weight * fresnel).mean((2, 3))], dim=-1)
    return table.float().to(device)


def _slanted(cosine: Tensor, alpha: Tensor) -> Tensor:
    """√(α² + (1 − α²)·cos²), of which Smith's masking is made."""
    return (alpha.square() + (1 - alpha.square()) * cosine.square()).sqrt()


def specular_weight(reflectance: Tensor, cosine: Tensor, roughness: Tensor) -> Tensor:
    """F₀·scale + bias, bilinear in the table, NaN where given NaN; differentiable in all three.

    Args:
        reflectance: F₀ [..., C], what the surface reflects head-on.
        cosine: n·v [...], roughness: [...], both in [0, 1].
    """
    table = brdf_table(cosine.device)
    row, column = cosine.clamp(0, 1) * (SIZE - 1), roughness.clamp(0, 1) * (SIZE - 1)
    row0, column0 = (texel_below(place).clamp_max(SIZE - 2) for place in (row, column))
    down, right = (row - row0)[..., None], (column - column0)[..., None]
    corner = row0.long() * SIZE + column0.long()
    flat = table.reshape(-1, 2).to(cosine.dtype)
    above = torch.lerp(flat[corner], flat[corner + 1], right)
    below = torch.lerp(flat[corner + SIZE], flat[corner + SIZE + 1], right)
    scale, bias = torch.lerp(above, below, down).split(1, dim=-1)
    return reflectance * scale + bias
