"""Primitives shaded one by one, before they are blended: what methods share whose colors depend on normals."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import torch
from torch import Tensor

from envgs_bench.core import GaussianSet
from envgs_bench.core.torch.rotation import rotation_matrices
from envgs_bench.core.torch.sh import sh_basis
from envgs_bench.core.vectors import unit

from ..gaussians.parameters import SH_DC

DIELECTRIC = 0.04  # what a surface that is no metal reflects head-on
DARKER = math.log(3)  # less than what constant terms show, as logits: c_d is 1/4 where that is black
INDIRECT_DEGREE = 3  # of the indirect light's spherical harmonics


def seen_from(
    gaussians: GaussianSet, center: Tensor, shortest_axis: Literal["column", "row"] = "column"
) -> tuple[Tensor, Tensor, Tensor]:
    """Unit directions to the primitives from a camera's `center` [3], and their unit normals, [N, 3] each.

    A surfel's normal is that of its plane, a 3D Gaussian's is its shortest axis; both face the camera, and which of
    them were turned for that comes third, [N, 1]. Differentiable.

    Args:
        shortest_axis: of 3D Gaussians: that column of the rotation matrix, or what GaussianShader's code takes for it:
            the first row, its entries in the order of the scales, the smallest first.
    """
    directions = unit(gaussians.means - center)
    frames = rotation_matrices(gaussians.quaternions)
    if gaussians.is_surfels:
        normals = frames[..., 2]
    elif shortest_axis == "row":
        normals = frames[:, 0].gather(1, gaussians.scales.argsort(dim=1, stable=True))
    else:
        shortest = gaussians.scales.argmin(1)[:, None, None].expand(-1, 3, 1)
        normals = frames.gather(2, shortest)[..., 0]
    away = (normals * directions).sum(-1, keepdim=True) > 0
    return directions, torch.where(away, -normals, normals), away


def mirrored(directions: Tensor, normals: Tensor) -> tuple[Tensor, Tensor]:
    """Unit `directions` [..., 3] mirrored at unit normals that face them, and the cosines n·v [...] of their angles."""
    cosine = -(directions * normals).sum(-1)
    return directions + 2 * cosine[..., None] * normals, cosine


def colored(gaussians: GaussianSet, colors: Tensor) -> GaussianSet:
    """The set with one color [N, 3] ≥ 0 each, the same from everywhere."""
    return replace(gaussians, sh=((colors - 0.5) / SH_DC)[:, None])


def diffuse_color(sh: Tensor) -> Tensor:
    """The released codes' c_d [N, 3] = sigmoid(b − log 3); b is what the constant terms of `sh` [N, K, 3] show."""
    return (0.5 + SH_DC * sh[:, 0] - DARKER).sigmoid()


def to_srgb(linear: Tensor) -> Tensor:
    """Linear light ≥ 0 as sRGB (IEC 61966-2-1); differentiable, with a finite slope at 0."""
    curved = 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, curved)


def to_linear(encoded: Tensor) -> Tensor:
    """sRGB in [0, 1] as linear light."""
    return torch.where(encoded <= 0.04045, encoded / 12.92, ((encoded.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)


def reflectance_of(albedo: Tensor, metallic: Tensor) -> Tensor:
    """F₀ [..., 3] of albedo [..., 3] and metallic share [..., 1]."""
    return torch.lerp(torch.full_like(albedo, DIELECTRIC), albedo, metallic)


def from_sides(directions: Tensor, constant: Tensor, rest: Tensor) -> Tensor:
    """The light [N, 3] along `directions` [N, 3] of spherical harmonics [N, 3] and [N, 45]."""
    coefficients = torch.cat([constant, rest], dim=1)
    basis = sh_basis(directions, INDIRECT_DEGREE)[..., None]
    return (basis * coefficients.reshape(len(directions), -1, 3)).sum(1).clamp_min(0)
