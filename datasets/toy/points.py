"""A point cloud as structure from motion would leave it: on textured, diffuse surfaces, noisy, lost on mirrors."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from envgs_bench.core import View

Array = NDArray[np.floating[Any]]

COUNT = 6000
SMUDGE_SHARE = 0.06  # share of the points: dust and smudges on mirrors, triangulated where they are
GHOST_SHARE = 0.01  # share of the points: things seen in mirrors, triangulated behind them
MAX_GHOST_DISTANCE = 1.5  # world units behind the mirror
FAR_DISTANCES = (15.0, 60.0)  # world units
VISIBILITY = 0.02  # relative depth difference up to which a point counts as seen


def sfm_points(views: list[View], noise: float, far_points: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Points [P, 3], world frame, and their colors [P, 3] in [0, 1], sRGB.

    Most lie on surfaces without reflection, drawn where the pictures have strong gradients, kept if another view sees
    them too, colored by the mean over the views that do, and displaced by Gaussian noise of standard deviation
    `noise` (world units). The rest is what real reconstructions also hold: ghosts behind mirrors, and `far_points`
    on the sky, matched at whatever distance; and what little is fixed to a mirror, its dust and smudges.
    """
    near = [_on_surfaces(view, 2 * COUNT // len(views) + 1, rng) for view in views]
    points = np.concatenate(near)
    colors, seen_by = _mean_colors(points, views)
    kept = np.flatnonzero(seen_by >= 2)
    kept = rng.permutation(kept)[:COUNT]
    found: list[tuple[Array, Array]] = [(points[kept] + noise * rng.normal(size=(len(kept), 3)), colors[kept])]
    for total, choose in (
        (round(COUNT * SMUDGE_SHARE), lambda view, count: _on_mirrors(view, count, 0.0, noise, rng)),
        (round(COUNT * GHOST_SHARE), lambda view, count: _on_mirrors(view, count, MAX_GHOST_DISTANCE, noise, rng)),
        (far_points, lambda view, count: _far(view, count, rng)),
    ):
        found += [choose(view, count) for view, count in zip(views, _shares(total, len(views)), strict=True)]
    all_points, all_colors = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    return all_points, all_colors


def _shares(total: int, parts: int) -> list[int]:
    """`total` in whole parts, as equal as can be."""
    return np.diff(np.linspace(0, total, parts + 1).round().astype(int)).tolist()


def _on_surfaces(view: View, count: int, rng: np.random.Generator) -> Array:
    """Points at pixel centers of diffuse surfaces, the likelier the stronger the picture's gradient."""
    picture = view.image.double().numpy().mean(-1) / 255
    gradient = np.hypot(*np.gradient(picture))
    likelihood = np.where(_diffuse(view), gradient.reshape(-1) + 0.005, 0.0)
    usable = int((likelihood > 0).sum())
    if not usable:
        return np.empty((0, 3))
    chosen = rng.choice(likelihood.size, min(count, usable), replace=False, p=likelihood / likelihood.sum())
    return _unprojected(view, chosen, _depth(view)[chosen])


def _on_mirrors(view: View, count: int, behind: float, noise: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Points on mirrors or up to `behind` world units behind them on the line of sight, in the pictures' colors."""
    pixels = np.flatnonzero(_mirrors(view))
    chosen = rng.choice(pixels, min(count, pixels.size), replace=False)
    points = _unprojected(view, chosen, _depth(view)[chosen] + behind * rng.uniform(size=chosen.size))
    return points + noise * rng.normal(size=points.shape), _colors(view)[chosen]


def _far(view: View, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Points on the sky, at any distance that a match of two views might give."""
    pixels = np.flatnonzero(_depth(view) == 0)
    chosen = rng.choice(pixels, min(count, pixels.size), replace=False)
    distance = np.exp(rng.uniform(np.log(FAR_DISTANCES[0]), np.log(FAR_DISTANCES[1]), chosen.size))
    return _unprojected(view, chosen, distance), _colors(view)[chosen]


def _mean_colors(points: Array, views: list[View]) -> tuple[Array, Array]:
    """Mean color [P, 3] over the views that see each point, and how many do, [P]."""
    total, seen_by = np.zeros_like(points), np.zeros(len(points))
    for view in views:
        pixels, depth = (values.numpy() for values in view.camera.project(torch.from_numpy(points).float()))
        width, height = view.camera.width, view.camera.height
        inside = (depth > 0) & (pixels >= 0).all(1) & (pixels[:, 0] < width) & (pixels[:, 1] < height)
        flat = pixels[inside].astype(np.int64) @ np.array([1, width])
        agrees = abs(_depth(view)[flat] - depth[inside]) < VISIBILITY * depth[inside]
        visible = np.flatnonzero(inside)[agrees & _diffuse(view)[flat]]
        total[visible] += _colors(view)[flat[agrees & _diffuse(view)[flat]]]
        seen_by[visible] += 1
    return total / np.maximum(seen_by, 1)[:, None], seen_by


def _unprojected(view: View, pixels: NDArray[np.int64], depth: Array) -> Array:
    origins, directions = (rays.reshape(-1, 3).double().numpy() for rays in view.camera.rays())
    return origins[pixels] + depth[:, None] * directions[pixels]


def _diffuse(view: View) -> NDArray[np.bool_]:
    return (_depth(view) > 0) & ~_mirrors(view).reshape(-1)


def _mirrors(view: View) -> NDArray[np.bool_]:
    """[H, W]: what matching of features fails on; under a coat it finds the picture, as on what is diffuse."""
    return view.masks.get("mirror", view.masks["reflective"]).numpy()


def _depth(view: View) -> Array:
    assert view.depth is not None
    return view.depth.double().numpy().reshape(-1)


def _colors(view: View) -> Array:
    return view.image.double().numpy().reshape(-1, 3) / 255
