"""Sparse points that structure from motion left wrong, in the wrong places, or not at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from envgs_bench.core import Scene

MIN_POINTS = 8  # kept in any case: orientations need neighbors
FAR = 1.5  # distance from every training camera beyond which a point is far, × the scene radius
BOX_QUANTILE = 0.995  # share of the points' range, on each axis, that their box covers


def thin_out(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """A random `share` of the points."""
    return _kept(scene, np.sort(rng.permutation(len(scene.points))[: _count(scene, share)]))


def keep_nearest(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """The `share` of the points that are nearest to any training camera."""
    return _kept(scene, np.sort(np.argsort(_distances(scene), kind="stable")[: _count(scene, share)]))


def thin_out_far(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """All points but of those that are far from every training camera, a sky, which keep a random `share`."""
    far = np.flatnonzero(_distances(scene) > FAR * scene.radius)
    dropped = rng.permutation(far)[: len(far) - round(share * len(far))]
    return _kept(scene, np.setdiff1d(np.arange(len(scene.points)), dropped))


def scatter(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """Points displaced by normal noise, on each axis with a deviation of `share` of the scene radius."""
    noise = share * scene.radius * torch.from_numpy(rng.normal(size=tuple(scene.points.shape)))
    return replace(scene, points=scene.points + noise.to(scene.points))


def move_to_cameras(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """A random `share` of the points at the centers of training cameras, all cameras alike; colors stay."""
    moved = rng.permutation(len(scene.points))[: round(share * len(scene.points))]
    points = scene.points.clone()
    points[moved] = _centers(scene)[np.arange(len(moved)) % len(scene.train)]
    return replace(scene, points=points)


def randomize(scene: Scene, extent: float, rng: np.random.Generator) -> Scene:
    """As many points at random, of random colors, in `extent` × the box that holds 99.5 % of the range of the points.

    3DGS's start where there is no structure from motion; its box is the scene's, which somebody has to know.
    """
    positions = scene.points.double().numpy()
    tail = (1 - BOX_QUANTILE) / 2
    low, high = np.quantile(positions, [tail, 1 - tail], axis=0)
    unit = extent * (rng.uniform(size=positions.shape) - 0.5) + 0.5
    points = torch.from_numpy(low + unit * (high - low)).to(scene.points)
    return replace(scene, points=points, point_colors=torch.from_numpy(rng.uniform(size=positions.shape)).to(points))


def _kept(scene: Scene, rows: np.ndarray) -> Scene:
    index = torch.from_numpy(rows)
    return replace(scene, points=scene.points[index], point_colors=scene.point_colors[index])


def _count(scene: Scene, share: float) -> int:
    return min(len(scene.points), max(MIN_POINTS, round(share * len(scene.points))))


def _distances(scene: Scene) -> np.ndarray:
    """[P] from each point to the nearest training camera."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(_centers(scene).numpy()).query(scene.points.numpy())[0])


def _centers(scene: Scene) -> Tensor:
    """[V, 3] of the training cameras."""
    return torch.stack([view.camera.center for view in scene.train]).to(scene.points)
