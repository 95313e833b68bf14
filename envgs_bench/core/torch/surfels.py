"""Surfels: where a ray intersects their plane, traced or rasterized."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..camera import Camera
from ..gaussians import GaussianSet
from .colors import seen_color
from .intersections import Intersections, Intersector
from .pixels import Pixels
from .rotation import rotation_matrices

EDGE_ON = 1e-12  # a ray within this of a surfel's plane (n·d) does not intersect it
LOW_PASS_INVERSE_VARIANCE = 2.0  # 1/px²: a screen-space Gaussian of √2/2 px


@dataclass(frozen=True)
class PlaneHits:
    """Where rays intersect the planes of surfels."""

    t: Tensor
    rho: Tensor
    facing: Tensor
    exists: Tensor


def intersect_planes(origins: Tensor, directions: Tensor, means: Tensor, frames: Tensor, scales: Tensor) -> PlaneHits:
    """Intersect rays o + t·d with the planes of surfels; all arguments' leading shapes broadcast.

    t = −(o − p)·n / d·n;  u = (o + t·d − p)·t_u / s_u, v likewise;  ρ = u² + v².
    """
    tangent_u, tangent_v, normal = frames.unbind(-1)
    offsets = origins - means
    slope = dot(directions, normal)
    exists = slope.abs() > EDGE_ON
    t = -dot(offsets, normal) / torch.where(exists, slope, 1)
    u = (dot(offsets, tangent_u) + t * dot(directions, tangent_u)) / scales[..., 0]
    v = (dot(offsets, tangent_v) + t * dot(directions, tangent_v)) / scales[..., 1]
    rho = u * u + v * v
    facing = torch.where(slope > 0, -1, 1).to(t)
    return PlaneHits(t, rho, facing, exists & t.isfinite() & rho.isfinite())


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Dot products over the last axis; component by component is several times faster than a sum over an axis of 3."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


class TracedSurfels(Intersector):
    """Surfels along arbitrary rays, in the order of their hits."""

    def __init__(
        self, gaussians: GaussianSet, origins: Tensor, directions: Tensor, t_min: float, sh_along_ray: bool = False
    ) -> None:
        self.gaussians, self.origins, self.directions, self.t_min = gaussians, origins, directions, t_min
        self.sh_along_ray = sh_along_ray
        self.shape = (len(origins),)
        self.frames = rotation_matrices(gaussians.quaternions)
        self.axes = self.frames[:, :, 2]

    def intersect(self, rays: Tensor, primitives: Tensor, means: Tensor) -> Intersections:
        plane = intersect_planes(
            self.origins[rays], self.directions[rays], means, self.frames[primitives], self.gaussians.scales[primitives]
        )
        valid = plane.exists & (plane.t >= self.t_min)
        return Intersections(plane.t, plane.rho, order=plane.t, facing=plane.facing, valid=valid)

    def colors(self, rays: Tensor, primitives: Tensor) -> Tensor:
        if self.sh_along_ray:
            return seen_color(self.gaussians.sh[primitives], self.directions[rays])
        return seen_color(self.gaussians.sh[primitives], self.gaussians.means[primitives] - self.origins[rays])


class RasterizedSurfels(Intersector):
    """Surfels as a camera sees them, in the order of their centers' depth."""

    def __init__(self, gaussians: GaussianSet, camera: Camera, near: float, low_pass: bool) -> None:
        self.gaussians, self.near, self.low_pass = gaussians, near, low_pass
        self.pixels = Pixels(camera, gaussians.means.dtype)
        self.shape = (camera.height, camera.width)
        self.frames = rotation_matrices(gaussians.quaternions)
        self.axes = self.frames[:, :, 2]
        self.color_of = seen_color(gaussians.sh, gaussians.means - self.pixels.center)

    def intersect(self, rays: Tensor, primitives: Tensor, means: Tensor) -> Intersections:
        frames, scales = self.frames[primitives], self.gaussians.scales[primitives]
        plane = intersect_planes(self.pixels.center, self.pixels.directions[rays], means, frames, scales)
        valid = plane.exists & (plane.t >= self.near)
        t, rho = plane.t, plane.rho
        depths = self.pixels.depths(means)
        smaller = None
        if self.low_pass:
            in_front = (depths >= self.near) & (depths > 0)
            squared_px = self.pixels.squared_distance(rays, means, in_front)
            on_screen = LOW_PASS_INVERSE_VARIANCE * squared_px
            smaller = in_front & (~valid | (on_screen < rho))
            t = torch.where(smaller, depths, t)
            rho = torch.where(smaller, on_screen, rho)
            valid = valid | in_front
        order = depths.expand_as(t)
        return Intersections(t, rho, order=order, facing=plane.facing, valid=valid, low_pass=smaller)

    def colors(self, rays: Tensor, primitives: Tensor) -> Tensor:
        return self.color_of[primitives]
