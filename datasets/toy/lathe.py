"""Lathe: a smooth profile turned about the vertical axis: bowls, vases, round table tops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from .shapes import Array


@dataclass(frozen=True)
class Lathe:
    """A cubic spline through (radius, height) points, from v = 0 to v = 1, turned about +z through `base`.

    Normals point to the left of the way along the profile, radius drawn to the right and height up: on a profile that
    runs from the top middle outward and down they point outward.
    """

    base: tuple[float, float, float]
    profile: tuple[tuple[float, float], ...]

    @property
    def cells(self) -> tuple[int, int]:
        return 192, 12 * len(self.profile)

    @property
    def extent(self) -> tuple[float, float]:
        points = np.array(self.profile)
        return 2 * np.pi * float(points[:, 0].max()), float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())

    def evaluate(self, u: Array, v: Array) -> tuple[Array, Array]:
        points = np.array(self.profile)
        length = np.cumsum([0, *np.linalg.norm(np.diff(points, axis=0), axis=1)])
        spline = CubicSpline(length / length[-1], points)
        (radius, height), (widening, rising) = (np.moveaxis(values, -1, 0) for values in (spline(v), spline(v, 1)))
        x, y = np.cos(2 * np.pi * u), np.sin(2 * np.pi * u)
        surface = np.array(self.base) + np.stack([radius * x, radius * y, height], axis=-1)
        normals = np.stack([-rising * x, -rising * y, widening + 0 * x], axis=-1)
        return surface, normals / np.linalg.norm(normals, axis=-1, keepdims=True)
