"""Points as structure from motion leaves them: at corners of pictures, few on what shines, some where nothing is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from envgs_bench.core import View

from ..toy.world import Array
from .distribution import ON_SHINING, ON_SKY, OUTLIERS, POINT_NOISE, POINTS, VIRTUAL, between, whole
from .truth import Truth

AGREES = 0.02  # relative difference of depth up to which a view sees a point
FAR: tuple[float, float] = (15.0, 60.0)  # distance of points on the sky, meters
DISPARITY = 4.0  # by how much a point is worse along the line of sight than across it


@dataclass(frozen=True)
class Cloud:
    """Points [P, 3], world frame, and their colors [P, 3] in [0, 1], sRGB."""

    points: Array
    colors: Array


def sfm_cloud(views: Sequence[View], truths: Sequence[Truth], rng: np.random.Generator) -> Cloud:
    """A cloud of the training views, of a quality that is drawn from the distribution.

    Corners of the pictures are drawn, the likelier the stronger they are, less where they lie on what shines, and kept
    where a second view sees them. On mirrors and glass, some are found where the mirrored thing seems to be.
    """
    total, shining = between(rng, POINTS), between(rng, ON_SHINING)
    noise, virtual = between(rng, POINT_NOISE), between(rng, VIRTUAL)
    share = int(2.2 * total / len(views)) + 1
    found = [_of_view(v, t, share, (shining, virtual, noise), rng) for v, t in zip(views, truths, strict=True)]
    real = np.concatenate([points for points, _, ghost in found])
    colors = np.concatenate([color for _, color, _ in found])
    ghosts = np.concatenate([ghost for *_, ghost in found])
    kept = np.flatnonzero(ghosts | (_seen_by(real, views) >= 2))
    kept = rng.permutation(kept)[: round(total)]
    clouds = [(real[kept], colors[kept]), _outliers(real, colors, round(total * between(rng, OUTLIERS)), rng)]
    clouds += [
        _on_sky(view, count, rng) for view, count in zip(views, _shares(whole(rng, ON_SKY), len(views)), strict=True)
    ]
    points, all_colors = (np.concatenate(arrays) for arrays in zip(*clouds, strict=True))
    return Cloud(points, np.round(255 * all_colors) / 255)


def _of_view(
    view: View, truth: Truth, count: int, quality: tuple[float, float, float], rng: np.random.Generator
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Points, colors, and which of them are images behind mirrors."""
    shining, virtual, noise = quality
    light = view.image.double().numpy().mean(-1) / 255
    regions = truth.regions
    likely = np.hypot(*np.gradient(light)) + 0.004
    likely *= np.where(regions["coated"] | regions["rough"], shining, 1.0)
    likely *= np.where(regions["mirror"] | regions["transmissive"], shining / 3, 1.0)
    likely = np.where(truth.depth > 0, likely, 0).reshape(-1)
    usable = int((likely > 0).sum())
    if not usable:
        return np.empty((0, 3)), np.empty((0, 3)), np.empty(0, np.bool_)
    chosen = rng.choice(likely.size, min(count, usable), replace=False, p=likely / likely.sum())
    origins, directions = (rays.reshape(-1, 3).double().numpy()[chosen] for rays in view.camera.rays())
    depth = truth.depth.reshape(-1)[chosen].astype(np.float64)
    sharp = (regions["mirror"] | regions["transmissive"]).reshape(-1)[chosen]
    ghost = sharp & (rng.uniform(size=len(chosen)) < virtual)
    behind = truth.mirrored.reshape(-1)[chosen] / np.linalg.norm(directions, axis=1)
    depth = np.where(ghost, depth + behind, depth)
    pixel = noise * depth / float(view.camera.intrinsics[0, 0])
    depth = depth + DISPARITY * pixel * rng.normal(size=len(chosen))
    points = origins + depth[:, None] * directions + pixel[:, None] * rng.normal(size=(len(chosen), 3))
    return points, _colors(view)[chosen], ghost


def _seen_by(points: Array, views: Sequence[View]) -> NDArray[np.int64]:
    """How many views see each point."""
    seen = np.zeros(len(points), np.int64)
    for view in views:
        assert view.depth is not None
        pixels, depth = (values.numpy() for values in view.camera.project(torch.from_numpy(points).float()))
        width, height = view.camera.width, view.camera.height
        inside = np.flatnonzero((depth > 0) & (pixels >= 0).all(1) & (pixels[:, 0] < width) & (pixels[:, 1] < height))
        met = view.depth.numpy().reshape(-1)[pixels[inside].astype(np.int64) @ np.array([1, width])]
        seen[inside[np.abs(met - depth[inside]) < AGREES * depth[inside]]] += 1
    return seen


def _outliers(points: Array, colors: Array, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Colors of the cloud, anywhere in its box."""
    low, high = (np.quantile(points, share, axis=0) for share in (0.02, 0.98))
    return low + (high - low) * rng.uniform(size=(count, 3)), colors[rng.integers(0, len(colors), count)]


def _on_sky(view: View, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    assert view.depth is not None
    pixels = np.flatnonzero(view.depth.numpy().reshape(-1) == 0)
    chosen = rng.choice(pixels, min(count, pixels.size), replace=False)
    nearest, farthest = (float(np.log(end)) for end in FAR)
    distance = np.exp(rng.uniform(nearest, farthest, chosen.size))
    origins, directions = (rays.reshape(-1, 3).double().numpy()[chosen] for rays in view.camera.rays())
    return origins + distance[:, None] * directions, _colors(view)[chosen]


def _shares(total: int, parts: int) -> list[int]:
    return np.diff(np.linspace(0, total, parts + 1).round().astype(int)).tolist()


def _colors(view: View) -> Array:
    return view.image.double().numpy().reshape(-1, 3) / 255
