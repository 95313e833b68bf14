"""Rod: a straight round bar between two points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .shapes import Array


@dataclass(frozen=True)
class Rod:
    """The side of a cylinder from `start` (v = 0) to `end`, open at both."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float

    @property
    def cells(self) -> tuple[int, int]:
        return 24, 1

    @property
    def extent(self) -> tuple[float, float]:
        return 2 * np.pi * self.radius, float(np.linalg.norm(np.subtract(self.end, self.start)))

    def evaluate(self, u: Array, v: Array) -> tuple[Array, Array]:
        along = np.subtract(self.end, self.start)
        axis = along / np.linalg.norm(along)
        first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        first /= np.linalg.norm(first)
        second = np.cross(first, axis)
        angle = 2 * np.pi * u[..., None]
        normals = np.cos(angle) * first + np.sin(angle) * second
        return np.array(self.start) + v[..., None] * along + self.radius * normals, normals
