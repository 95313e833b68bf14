"""Sights: where cameras stand, and how far what they see is from them; in float64, for worlds of any place and size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_CAMERAS, MOST_POINTS = 64, 20_000  # that are looked at, evenly chosen
LEAST_SEEN = 8  # points that a camera must see, to say how far things are
NEAREST = 0.05  # quantile of what a camera sees that counts as its nearest
NEAREST_AT_LEAST = 1 / 32  # of the usual distance: nearer points are few and astray
CONVERGING = 0.01  # least eigenvalue of the axes' mean I − zzᵀ: below, they are parallel
NEAREST_SHARE = 0.5  # of the usual distance, where no points tell
TOLD_APART = 1e-12  # of their distance from the origin, by which cameras are apart
SPREADS = 10.0  # of the cameras: the usual distance where nothing else tells, as of cameras that face one way


@dataclass(frozen=True)
class Sights:
    """Cameras with a rotation and a translation, and the points [P, 3] that they may see; data's coordinates.

    Attributes:
        poses: [V, 4, 4] world to camera.
        focals: [V] pixels.
        sizes: [V, 2] width and height, pixels.
    """

    poses: Array
    focals: Array
    sizes: Array
    points: Array

    @property
    def centers(self) -> Array:
        """[V, 3]; exact where a rotation is only one to seven digits."""
        return np.asarray(-np.linalg.solve(self.poses[:, :3, :3], self.poses[:, :3, 3:])[..., 0], np.float64)

    @property
    def middle(self) -> Array:
        """[3]: the cameras' median on each axis, which a few of them astray do not move."""
        return np.median(self.centers, axis=0)

    @property
    def spread(self) -> float:
        """The median distance of the cameras from their middle; 0 where float64 hardly tells them apart."""
        spread = float(np.median(np.linalg.norm(self.centers - self.middle, axis=1)))
        return spread if spread > TOLD_APART * np.abs(self.middle).max() else 0.0

    @property
    def focal(self) -> float:
        return float(np.median(self.focals))

    def depths(self) -> tuple[float, float] | None:
        """How far the nearest things, and usual ones, are from the median camera; None where nothing tells.

        Points in a camera's picture tell; where most cameras see none, the place that all look at does, or else how
        far the cameras are apart.
        """
        chosen, centers = _evenly(len(self.poses), MOST_CAMERAS), self.centers
        points = self.points[_evenly(len(self.points), MOST_POINTS)]
        seen = [_depths(self.poses[i], centers[i], self.focals[i], self.sizes[i], points) for i in chosen]
        told = [np.quantile(depths, [NEAREST, 0.5]) for depths in seen if len(depths) >= LEAST_SEEN]
        if 2 * len(told) >= len(chosen):
            nearest, usual = (float(depth) for depth in np.median(told, axis=0))
            return max(nearest, NEAREST_AT_LEAST * usual), usual
        around = self.looked_at()
        usual = SPREADS * self.spread if around is None else around[1]
        return (NEAREST_SHARE * usual, usual) if usual > 0 else None

    def looked_at(self) -> tuple[Array, float] | None:
        """The point [3] nearest to all cameras' axes, and the median camera's distance from it.

        It minimizes Σ ‖(I − zzᵀ)(p − c)‖² over centers c and viewing directions z. None where most cameras look away
        from it, or all the same way, or stand in one place.
        """
        axes, centers = self.poses[:, 2, :3], self.centers - self.middle
        across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
        if not self.spread or np.linalg.eigvalsh(across.mean(0))[0] < CONVERGING:
            return None
        point = np.linalg.solve(across.sum(0), (across @ centers[:, :, None]).sum(0))[:, 0]
        ahead = ((point - centers) * axes).sum(1)
        if np.median(ahead) <= 0:
            return None
        return point + self.middle, float(np.median(ahead))


def _depths(pose: Array, center: Array, focal: float, size: Array, points: Array) -> Array:
    """Of those of the points that lie in the picture, its axis in the middle."""
    x, y, z = ((points - center) @ pose[:3, :3].T).T
    inside = (z > 0) & (np.abs(x) * 2 * focal <= z * size[0]) & (np.abs(y) * 2 * focal <= z * size[1])
    return z[inside]


def _evenly(count: int, most: int) -> Sequence[int] | NDArray[np.int64]:
    return range(count) if count <= most else np.linspace(0, count - 1, most).round().astype(np.int64)
