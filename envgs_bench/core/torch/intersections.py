"""Intersections of rays and primitives: what rasterized surfels, traced surfels and rasterized 3D Gaussians share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor

from ..gaussians import GaussianSet

MAX_RHO = 9.0  # a support never reaches beyond three standard deviations
MIN_ALPHA = 1 / 255  # nor to where a response falls below this
MAX_ALPHA = 0.99


@dataclass(frozen=True)
class Intersections:
    """Where rays intersect primitives. All fields have one shape, that of the rays and primitives given."""

    t: Tensor  # distance along the ray, in units of its direction's length; for a camera's rays, camera-frame depth
    rho: Tensor  # squared distance from the primitive's center, in standard deviations
    order: Tensor  # hits of a ray are blended in ascending order of this, equal ones by index
    facing: Tensor  # ±1: what turns the primitive's normal toward the viewer
    valid: Tensor  # bool: false where the ray misses, whatever rho is (edge-on, before the near plane)
    low_pass: Tensor | None = None  # bool: where anti-aliasing answers in the primitive's place; None: nowhere


class Intersector(ABC):
    """One call's primitives and rays: where they intersect, and which colors are seen."""

    gaussians: GaussianSet
    shape: tuple[int, ...]  # the rays' shape, [H, W] or [R]; a ray's index counts row by row
    axes: Tensor  # [N, 3] unit normals, sign arbitrary

    @abstractmethod
    def intersect(self, rays: Tensor, primitives: Tensor, means: Tensor) -> Intersections:
        """Intersect rays and primitives, indices that broadcast; `means` [..., 3] are the primitives'."""

    @abstractmethod
    def colors(self, rays: Tensor, primitives: Tensor) -> Tensor:
        """Colors [P, 3] of the primitives [P] seen along the rays [P]."""


def cutoffs(opacities: Tensor) -> Tensor:
    """The largest ρ at which primitives of these opacities are drawn, min(3², 2·ln(255·opacity)); −1 where nowhere."""
    visible = opacities > MIN_ALPHA
    response = torch.where(visible, opacities / MIN_ALPHA, 1)
    return torch.where(visible, (2 * response.log()).clamp_max(MAX_RHO), -1).detach()


def alphas(opacities: Tensor, rho: Tensor) -> Tensor:
    """min(0.99, opacity·exp(−ρ/2)); the clamp passes no gradient."""
    return (opacities * (-rho / 2).exp()).clamp_max(MAX_ALPHA)
