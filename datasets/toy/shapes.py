"""Parametric surfaces: exact points and normals at any (u, v), and the triangle meshes that Embree intersects.

On every surface u and v run over [0, 1]; seen from the side its normal points to, a texture lies upright:
u to the right, v down.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]


class Shape(Protocol):
    @property
    def cells(self) -> tuple[int, int]:
        """How many cells the mesh has along u and along v."""

    @property
    def extent(self) -> tuple[float, float]:
        """Length along u and along v, world units."""

    def evaluate(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Points and unit normals, each [..., 3], at u and v of one shape [...]."""


@dataclass(frozen=True)
class Mesh:
    """Triangles with smooth normals and texture coordinates a vertex."""

    vertices: Array  # [V, 3]
    normals: Array  # [V, 3] unit
    uv: Array  # [V, 2]
    faces: NDArray[np.int32]  # [F, 3]


def tessellate(shape: Shape | Mesh) -> Mesh:
    """The shape as a lattice of triangles, two a cell. Seams and poles keep separate vertices, so uv never wraps."""
    if isinstance(shape, Mesh):
        return shape
    columns, rows = shape.cells
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    vertices, normals = shape.evaluate(u, v)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).reshape(-1, 1)
    faces = corner + np.array([[0, columns + 1, 1, 1, columns + 1, columns + 2]])
    return Mesh(
        vertices.reshape(-1, 3),
        normals.reshape(-1, 3),
        np.stack([u, v], axis=-1).reshape(-1, 2),
        faces.reshape(-1, 3).astype(np.int32),
    )


@dataclass(frozen=True)
class Rectangle:
    """corner + u·across + v·down; the normal is down × across."""

    corner: tuple[float, float, float]
    across: tuple[float, float, float]
    down: tuple[float, float, float]

    @property
    def cells(self) -> tuple[int, int]:
        return 1, 1

    @property
    def extent(self) -> tuple[float, float]:
        return float(np.linalg.norm(self.across)), float(np.linalg.norm(self.down))

    def evaluate(self, u: Array, v: Array) -> tuple[Array, Array]:
        across, down = np.array(self.across), np.array(self.down)
        points = np.array(self.corner) + u[..., None] * across + v[..., None] * down
        normal = np.cross(down, across)
        return points, np.broadcast_to(normal / np.linalg.norm(normal), points.shape)


@dataclass(frozen=True)
class Sphere:
    """Around `center`; v = 0 is the pole at +z. `top` < 1 leaves out what lies below latitude 90° − 180°·top."""

    center: tuple[float, float, float]
    radius: float
    top: float = 1.0

    @property
    def cells(self) -> tuple[int, int]:
        return 256, int(128 * self.top)

    @property
    def extent(self) -> tuple[float, float]:
        return 2 * np.pi * self.radius, np.pi * self.radius * self.top

    def evaluate(self, u: Array, v: Array) -> tuple[Array, Array]:
        longitude, colatitude = 2 * np.pi * u, np.pi * self.top * v
        flat = np.sin(colatitude)
        normals = np.stack([flat * np.cos(longitude), flat * np.sin(longitude), np.cos(colatitude)], axis=-1)
        return np.array(self.center) + self.radius * normals, normals


@dataclass(frozen=True)
class Cone:
    """The side of an upright, truncated cone (or cylinder) from `height` above `base` down to it."""

    base: tuple[float, float, float]
    radius_bottom: float
    radius_top: float
    height: float

    @property
    def cells(self) -> tuple[int, int]:
        return 192, 1

    @property
    def extent(self) -> tuple[float, float]:
        return np.pi * (self.radius_bottom + self.radius_top), float(np.hypot(self.height, self.widening))

    @property
    def widening(self) -> float:
        return self.radius_bottom - self.radius_top

    def evaluate(self, u: Array, v: Array) -> tuple[Array, Array]:
        angle = 2 * np.pi * u
        radius = self.radius_top + v * self.widening
        x, y, upright = np.cos(angle), np.sin(angle), np.ones_like(angle)
        points = np.array(self.base) + np.stack([radius * x, radius * y, (1 - v) * self.height], axis=-1)
        normals = np.stack([self.height * x, self.height * y, self.widening * upright], axis=-1)
        return points, normals / np.linalg.norm(normals, axis=-1, keepdims=True)


@dataclass(frozen=True)
class Disc:
    """A horizontal ring facing +z, between two radii; v = 0 is its inner edge."""

    center: tuple[float, float, float]
    radius: float
    inner: float = 0.0

    @property
    def cells(self) -> tuple[int, int]:
        return 192, 1

    @property
    def extent(self) -> tuple[float, float]:
        return 2 * np.pi * self.radius, self.radius - self.inner

    def evaluate(self, u: Array, v: Array) -> tuple[Array, Array]:
        angle, radius = 2 * np.pi * u, self.inner + v * (self.radius - self.inner)
        offset = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(angle)], axis=-1)
        return np.array(self.center) + offset, np.broadcast_to([0.0, 0.0, 1.0], offset.shape)


@dataclass(frozen=True)
class Torus:
    """A ring of radius `ring` around the axis +z through `center`, its tube of radius `tube`."""

    center: tuple[float, float, float]
    ring: float
    tube: float

    @property
    def cells(self) -> tuple[int, int]:
        return 256, 96

    @property
    def extent(self) -> tuple[float, float]:
        return 2 * np.pi * self.ring, 2 * np.pi * self.tube

    def evaluate(self, u: Array, v: Array) -> tuple[Array, Array]:
        around, across = 2 * np.pi * u, 2 * np.pi * v
        flat = np.sin(across)
        normals = np.stack([flat * np.cos(around), flat * np.sin(around), np.cos(across)], axis=-1)
        axis = np.stack([np.cos(around), np.sin(around), np.zeros_like(around)], axis=-1)
        return np.array(self.center) + self.ring * axis + self.tube * normals, normals


def box(base: tuple[float, float, float], size: tuple[float, float, float], turn_degrees: float) -> list[Rectangle]:
    """Five faces of a box that stands on its bottom: four sides, then the top, turned about its own vertical axis.

    `base` is the center of its bottom, `size` its lengths along x, y and z before the turn.
    """
    angle = np.radians(turn_degrees)
    x_axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    y_axis, up = np.array([-x_axis[1], x_axis[0], 0.0]), np.array([0.0, 0.0, size[2]])
    top = np.array(base) + up
    faces = []
    for side, across, half_depth, half_width in (
        (-y_axis, x_axis, size[1] / 2, size[0] / 2),
        (x_axis, y_axis, size[0] / 2, size[1] / 2),
        (y_axis, -x_axis, size[1] / 2, size[0] / 2),
        (-x_axis, -y_axis, size[0] / 2, size[1] / 2),
    ):
        start = top + side * half_depth - across * half_width
        faces.append(_rectangle(start, 2 * half_width * across, -up))
    start = top - x_axis * size[0] / 2 + y_axis * size[1] / 2
    faces.append(_rectangle(start, x_axis * size[0], -y_axis * size[1]))
    return faces


def _rectangle(corner: Array, across: Array, down: Array) -> Rectangle:
    return Rectangle(tuple(corner.tolist()), tuple(across.tolist()), tuple(down.tolist()))
