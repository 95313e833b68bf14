"""Waves: a rectangle with real, smooth bumps, whose normals are those of its surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .shapes import Array


@dataclass(frozen=True)
class Wave:
    """amplitude·sin(2π·(across·u + down·v + phase))."""

    amplitude: float  # world units
    across: float  # periods along u
    down: float  # periods along v
    phase: float = 0.0  # in periods


@dataclass(frozen=True)
class Waves:
    """corner + u·across + v·down + h(u, v)·n, n along down × across; h is the sum of the waves, 0 along the edge."""

    corner: tuple[float, float, float]
    across: tuple[float, float, float]
    down: tuple[float, float, float]
    waves: tuple[Wave, ...]

    @property
    def cells(self) -> tuple[int, int]:
        return 160, 160

    @property
    def extent(self) -> tuple[float, float]:
        return float(np.linalg.norm(self.across)), float(np.linalg.norm(self.down))

    def evaluate(self, u: Array, v: Array) -> tuple[Array, Array]:
        across, down = np.array(self.across, float), np.array(self.down, float)
        flat = np.cross(down, across)
        flat /= np.linalg.norm(flat)
        height, along_u, along_v = (values[..., None] for values in self._heights(u, v))
        points = np.array(self.corner) + u[..., None] * across + v[..., None] * down + height * flat
        normals = np.cross(down + along_v * flat, across + along_u * flat)
        return points, normals / np.linalg.norm(normals, axis=-1, keepdims=True)

    def _heights(self, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """h and its derivatives by u and by v."""
        height, by_u, by_v = (np.zeros_like(u, dtype=np.float64) for _ in range(3))
        for wave in self.waves:
            angle = 2 * np.pi * (wave.across * u + wave.down * v + wave.phase)
            height += wave.amplitude * np.sin(angle)
            by_u += wave.amplitude * np.cos(angle) * 2 * np.pi * wave.across
            by_v += wave.amplitude * np.cos(angle) * 2 * np.pi * wave.down
        (edge_u, slope_u), (edge_v, slope_v) = _level_edge(u), _level_edge(v)
        return (
            height * edge_u * edge_v,
            (by_u * edge_u + height * slope_u) * edge_v,
            (by_v * edge_v + height * slope_v) * edge_u,
        )


def _level_edge(position: Array) -> tuple[Array, Array]:
    """A factor that is 1 inside and falls to 0 at positions 0 and 1, and its derivative."""
    offset = 2 * position - 1
    return 1 - offset**8, -16 * offset**7
