"""Solids: curved shapes that the toys do without, from superellipsoids to a mesh of blobs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from skimage.measure import marching_cubes

from ..toy.shapes import Array, Mesh

Vector = tuple[float, float, float]


def _on_sphere(u: Array, v: Array) -> Array:
    longitude, colatitude = 2 * np.pi * u, np.pi * v
    flat = np.sin(colatitude)
    return np.stack([flat * np.cos(longitude), flat * np.sin(longitude), np.cos(colatitude)], axis=-1)


def _unit(vectors: Array) -> Array:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


@dataclass(frozen=True)
class Superellipsoid:
    """|x/a|^p + |y/b|^p + |z/c|^p = 1, turned about +z: an ellipsoid (p = 2) to a box with round edges (p = 8)."""

    center: Vector
    half: Vector  # a, b, c
    power: float
    turn_degrees: float = 0.0

    @property
    def cells(self) -> tuple[int, int]:
        return 160, 96

    @property
    def extent(self) -> tuple[float, float]:
        return np.pi * (self.half[0] + self.half[1]), np.pi * self.half[2]

    def evaluate(self, u: Array, v: Array) -> tuple[Array, Array]:
        direction, half = _on_sphere(u, v), np.array(self.half)
        length = (np.abs(direction) ** self.power).sum(-1, keepdims=True) ** (-1 / self.power)
        point = length * direction
        normal = _unit(np.sign(point) * np.abs(point) ** (self.power - 1) / half)
        angle = np.radians(self.turn_degrees)
        turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        return np.array(self.center) + (half * point) @ turn, normal @ turn


@dataclass(frozen=True)
class Lump:
    """A sphere with smooth bumps: radius · (1 + Σ amplitude·sin(frequency·direction + phase)), flattened by `flat`."""

    center: Vector
    radius: float
    bumps: tuple[tuple[float, Vector, float], ...]  # amplitude, frequency, phase
    flat: float = 1.0  # height beside width

    @property
    def cells(self) -> tuple[int, int]:
        return 192, 128

    @property
    def extent(self) -> tuple[float, float]:
        return 2 * np.pi * self.radius, np.pi * self.radius

    def evaluate(self, u: Array, v: Array) -> tuple[Array, Array]:
        direction = _on_sphere(u, v)
        size: Array = np.ones(direction.shape[:-1])
        slope: Array = np.zeros_like(direction)
        for amplitude, frequency, phase in self.bumps:
            angle = direction @ np.array(frequency) + phase
            size = size + amplitude * np.sin(angle)
            slope = slope + (amplitude * np.cos(angle))[..., None] * np.array(frequency)
        slope = slope - (slope * direction).sum(-1, keepdims=True) * direction
        stretch = np.array([1, 1, self.flat])
        normal = _unit((direction - slope / size[..., None]) / stretch)
        return np.array(self.center) + self.radius * size[..., None] * direction * stretch, normal


@dataclass(frozen=True)
class Knot:
    """A tube along a torus knot that winds `turns[0]` times around the axis and `turns[1]` times through the hole."""

    center: Vector
    radius: float
    tube: float
    turns: tuple[int, int] = (2, 3)

    @property
    def cells(self) -> tuple[int, int]:
        return 480, 32

    @property
    def extent(self) -> tuple[float, float]:
        return 2 * np.pi * self.radius * self.turns[0], 2 * np.pi * self.tube

    def evaluate(self, u: Array, v: Array) -> tuple[Array, Array]:
        step = 1e-4
        middle, ahead, behind = self._curve(u), self._curve(u + step), self._curve(u - step)
        along = _unit(ahead - behind)
        first: Array = ahead + behind - 2 * middle
        first = _unit(first - (first * along).sum(-1, keepdims=True) * along)
        angle = 2 * np.pi * v[..., None]
        normal = np.cos(angle) * first + np.sin(angle) * np.cross(along, first)
        return np.array(self.center) + middle + self.tube * normal, normal

    def _curve(self, u: Array) -> Array:
        around, through = 2 * np.pi * self.turns[0] * u, 2 * np.pi * self.turns[1] * u
        reach = self.radius * (2 + np.cos(through)) / 3
        return np.stack([reach * np.cos(around), reach * np.sin(around), -self.radius * np.sin(through) / 3], axis=-1)


def blobs(centers: Array, radii: Array, cells: int = 72) -> Mesh:
    """The surface where Σ radius²/distance² is 1, as a mesh: balls [B, 3] that run into each other."""
    low, high = (centers - 2.2 * radii[:, None]).min(0), (centers + 2.2 * radii[:, None]).max(0)
    axes = [np.linspace(low[axis], high[axis], cells) for axis in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = np.zeros(grid.shape[:3])
    for center, radius in zip(centers, radii, strict=True):
        values += radius**2 / np.maximum(((grid - center) ** 2).sum(-1), 1e-6)
    vertices, faces, *_ = marching_cubes(np.minimum(values, 4.0), 1.0, spacing=tuple((high - low) / (cells - 1)))
    vertices = vertices + low
    offset = vertices[:, None] - centers
    normals = _unit((offset * (radii**2 / ((offset**2).sum(-1) ** 2))[..., None]).sum(1))
    corners = vertices[faces]
    facing = (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * normals[faces[:, 0]]).sum(1)
    faces = np.where(facing[:, None] < 0, faces[:, ::-1], faces)
    return Mesh(vertices, normals, np.full((len(vertices), 2), 0.5), faces.astype(np.int32))
