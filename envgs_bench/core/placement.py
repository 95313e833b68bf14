"""Placement: where a scene's world lies in that of its data, for whatever goes in or out in the data's coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Placement:
    """data = shift + scale · world, of positions; axes are the same. All of it is computed in float64.

    A pose x = R·p + t of the data becomes x / scale = R·q + (t + R·shift) / scale of the world, and back.
    """

    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The world's origin, in the data's coordinates."""
    scale: float = 1.0
    """The world's unit, in the data's; a power of two, so that it costs no digits."""

    def __str__(self) -> str:
        return f"({', '.join(f'{x:.15g}' for x in self.shift)}) + {self.scale:g} · world"

    @property
    def unmoved(self) -> bool:
        """Whether the world is the data's own."""
        return self == Placement()

    def points_from_data(self, points: ArrayLike) -> Array:
        """Positions [..., 3] of the data, in the world."""
        return (np.asarray(points, np.float64) - self.shift) / self.scale

    def points_to_data(self, points: ArrayLike) -> Array:
        """Positions [..., 3] of the world, in the data's coordinates."""
        return np.asarray(points, np.float64) * self.scale + self.shift

    def pose_from_data(self, world_to_camera: ArrayLike) -> Array:
        """A pose [4, 4] of the data's, as the world's."""
        pose = np.array(world_to_camera, np.float64)
        pose[:3, 3] = (pose[:3, 3] + pose[:3, :3] @ self.shift) / self.scale
        return pose

    def pose_to_data(self, world_to_camera: ArrayLike) -> Array:
        """A pose [4, 4] of the world's, as the data's: for whoever uses this same rotation, to float64's last digit."""
        pose = np.array(world_to_camera, np.float64)
        pose[:3, 3] = pose[:3, 3] * self.scale - pose[:3, :3] @ self.shift
        return pose
