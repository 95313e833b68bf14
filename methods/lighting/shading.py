"""Primitives shaded one by one, before they are blended: what methods share whose colors depend on normals."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from envgs_bench.core import GaussianSet
from envgs_bench.core.torch.rotation import rotation_matrices
from envgs_bench.core.vectors import unit

from ..gaussians.parameters import SH_DC


def seen_from(gaussians: GaussianSet, center: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Unit directions to the primitives from a camera's `center` [3], and their unit normals, [N, 3] each.

    A surfel's normal is that of its plane, a 3D Gaussian's is its shortest axis; both face the camera, and which of
    them were turned for that comes third, [N, 1]. Differentiable.
    """
    directions = unit(gaussians.means - center)
    frames = rotation_matrices(gaussians.quaternions)
    if gaussians.is_surfels:
        normals = frames[..., 2]
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
