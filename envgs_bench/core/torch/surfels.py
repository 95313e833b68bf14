"""Surfels: where a ray crosses their plane, traced or rasterized."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..camera import Camera
from ..gaussians import GaussianSet
from .drawing import Drawing, Meeting
from .pixels import Pixels
from .rotation import rotation_matrices
from .sh import sh_color

EDGE_ON = 1e-12  # a ray within this of a surfel's plane (n·d) does not cross it
LOW_PASS_INVERSE_VARIANCE = 2.0  # 1/px²: a screen-space Gaussian of √2/2 px


@dataclass(frozen=True)
class Crossing:
    """Where rays cross the planes of surfels."""

    t: Tensor
    rho: Tensor
    facing: Tensor
    exists: Tensor


def cross(origins: Tensor, directions: Tensor, means: Tensor, frames: Tensor, scales: Tensor) -> Crossing:
    """Cross rays o + t·d with the planes of surfels; all arguments' leading shapes broadcast.

    With A = diag(1/s_u, 1/s_v, 1)·Rᵀ, o' = A(o − p) and d' = A·d: t = −o'_z / d'_z, (u, v) = o'_xy + t·d'_xy.
    """
    lengths = torch.cat([scales, torch.ones_like(scales[..., :1])], dim=-1)
    o = ((origins - means)[..., None] * frames).sum(-2) / lengths
    d = (directions[..., None] * frames).sum(-2) / lengths
    exists = d[..., 2].abs() > EDGE_ON
    t = -o[..., 2] / torch.where(exists, d[..., 2], 1)
    uv = o[..., :2] + t[..., None] * d[..., :2]
    rho = (uv * uv).sum(-1)
    facing = torch.where(d[..., 2] > 0, -1, 1).to(t)
    return Crossing(t, rho, facing, exists & t.isfinite() & rho.isfinite())


class TracedSurfels(Drawing):
    """Surfels along arbitrary rays, in the order of their hits."""

    def __init__(self, gaussians: GaussianSet, origins: Tensor, directions: Tensor, t_min: float) -> None:
        self.gaussians, self.origins, self.directions, self.t_min = gaussians, origins, directions, t_min
        self.shape = (len(origins),)
        self.frames = rotation_matrices(gaussians.quaternions)
        self.axes = self.frames[:, :, 2]

    def meet(self, rays: Tensor, primitives: Tensor, means: Tensor) -> Meeting:
        crossing = cross(
            self.origins[rays], self.directions[rays], means, self.frames[primitives], self.gaussians.scales[primitives]
        )
        possible = crossing.exists & (crossing.t >= self.t_min)
        return Meeting(crossing.t, crossing.rho, order=crossing.t, facing=crossing.facing, possible=possible)

    def colors(self, rays: Tensor, primitives: Tensor) -> Tensor:
        return sh_color(self.gaussians.sh[primitives], self.gaussians.means[primitives] - self.origins[rays])


class RasterizedSurfels(Drawing):
    """Surfels as a camera sees them, in the order of their centres' depth."""

    def __init__(self, gaussians: GaussianSet, camera: Camera, near: float, low_pass: bool) -> None:
        self.gaussians, self.near, self.low_pass = gaussians, near, low_pass
        self.pixels = Pixels(camera, gaussians.means.dtype)
        self.shape = (camera.height, camera.width)
        self.frames = rotation_matrices(gaussians.quaternions)
        self.axes = self.frames[:, :, 2]
        self.color_of = sh_color(gaussians.sh, gaussians.means - self.pixels.centre)

    def meet(self, rays: Tensor, primitives: Tensor, means: Tensor) -> Meeting:
        frames, scales = self.frames[primitives], self.gaussians.scales[primitives]
        crossing = cross(self.pixels.centre, self.pixels.directions[rays], means, frames, scales)
        possible = crossing.exists & (crossing.t >= self.near)
        t, rho = crossing.t, crossing.rho
        depths = self.pixels.depths(means)
        if self.low_pass:
            ahead = (depths >= self.near) & (depths > 0)
            squared_px = self.pixels.squared_distance(rays, means, ahead)
            on_screen = LOW_PASS_INVERSE_VARIANCE * squared_px
            smaller = ahead & (~possible | (on_screen < rho))
            t = torch.where(smaller, depths, t)
            rho = torch.where(smaller, on_screen, rho)
            possible = possible | ahead
        return Meeting(t, rho, order=depths.expand_as(t), facing=crossing.facing, possible=possible)

    def colors(self, rays: Tensor, primitives: Tensor) -> Tensor:
        return self.color_of[primitives]
