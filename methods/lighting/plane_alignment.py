"""Planes aligned with the photographs: moved and turned until what the base set mirrors there is what views show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, GaussianSet, View, build_bvh, trace
from envgs_bench.core.vectors import rotated, unit

from ..gaussians.model import GaussianModel
from .plane_proposals import Rectangle, inside_of

VIEWS, COLUMNS = 4, 48  # that are compared, at most; pixels across
STEPS = (0.04, 0.02, 0.01, 0.005, 0.0025, 0.00125)  # scene radii and radians that a plane is tried beside where it is
ROUNDS, GAIN = 2, 1e-3  # at each of these; correlation by which another place has to be better
MIRROR = 0.35  # correlation of what is mirrored with what views show, from which a plane is a mirror
LEAST, MOST = 0.8, 0.95  # reflectance that a mirror begins with
MARGIN = 0.01  # × scene radius, nearer than which a mirrored ray sees nothing


@dataclass(frozen=True)
class Aligned:
    """A plane in its place, and how much it reflects."""

    rectangle: Rectangle
    reflectance: float


@torch.no_grad()
def aligned(
    base: GaussianSet, planes: Sequence[Aligned], views: Sequence[View], model: GaussianModel, furthest: float
) -> list[Aligned]:
    """The mirrors among the planes where the base set, mirrored, correlates best with some of the views.

    What does not correlate is no mirror, and stays where and as it is.

    Args:
        furthest: the largest step, scene radii and radians, by which a plane is tried beside its place.
    """
    some = [_reduced(view, model.device) for view in views[:: max(1, -(-len(views) // VIEWS))]]
    bvh = build_bvh(base, backend=model.settings.backend)

    def shown(plane: Rectangle) -> tuple[Tensor, Tensor]:
        """What the plane mirrors and what the views show there, [K, 3] each."""
        pairs = []
        for camera, image in some:
            origins, rays = camera.rays()
            rays = unit(rays)
            within, distance = inside_of(plane, origins, rays, 1e-3 * model.radius)
            normal = plane.axes[2]
            mirrored = (rays - 2 * (rays @ normal)[..., None] * normal) * (within > 0.5)[..., None]
            points = origins + distance.clamp(0, 1e4)[..., None] * rays
            drawn = trace(
                base,
                points,
                mirrored,
                background=model.background,
                t_min=MARGIN * model.radius,
                bvh=bvh,
                backend=model.settings.backend,
            )
            kept = within > 0.5
            pairs.append((drawn.color[kept], image[kept]))
        return torch.cat([each for each, _ in pairs]), torch.cat([each for _, each in pairs])

    return [_aligned(plane, shown, model.radius, furthest) for plane in planes]


def _aligned(
    plane: Aligned, shown: Callable[[Rectangle], tuple[Tensor, Tensor]], radius: float, furthest: float
) -> Aligned:
    best, score = plane.rectangle, _correlation(*shown(plane.rectangle))
    for step in [each for each in STEPS if each <= furthest]:
        for _ in range(ROUNDS):
            before = score
            for axis, sign in product(range(3), (1, -1)):
                tried = _beside(best, axis, sign * step, radius)
                value = _correlation(*shown(tried))
                if value > score + GAIN:
                    best, score = tried, value
            if score == before:
                break
    if score < MIRROR:
        return plane
    return Aligned(best, min(max(float(_slope(*shown(best))), plane.reflectance, LEAST), MOST))


def _reduced(view: View, device: torch.device) -> tuple[Camera, Tensor]:
    factor = max(1, view.camera.width // COLUMNS)
    size = (view.camera.height // factor, view.camera.width // factor)
    image = functional.interpolate(view.rgb(device).permute(2, 0, 1)[None], size, mode="area")[0].permute(1, 2, 0)
    return view.camera.to(device).resized(size[1], size[0]), image


def _beside(plane: Rectangle, axis: int, by: float, radius: float) -> Rectangle:
    """The plane turned about one of its own axes, or moved along its normal."""
    if axis == 2:
        return Rectangle(plane.center + by * radius * plane.axes[2], plane.axes, plane.half)
    return Rectangle(plane.center, rotated(plane.axes, (by * plane.axes[axis]).expand(3, 3)), plane.half)


def _correlation(one: Tensor, other: Tensor) -> float:
    one, other = one - one.mean(0), other - other.mean(0)
    return float((one * other).sum() / (one.norm() * other.norm()).clamp_min(1e-12))


def _slope(one: Tensor, other: Tensor) -> Tensor:
    """By how much `other` grows with `one`."""
    one, other = one - one.mean(0), other - other.mean(0)
    return (one * other).sum() / one.square().sum().clamp_min(1e-12)
