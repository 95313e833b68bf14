"""World: a toy scene ready for rays. Embree finds the hits; every surface carries its outgoing light as a texture."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from .shapes import Mesh, Shape, tessellate

Array = NDArray[np.floating[Any]]
Index = NDArray[np.int64]

OFFSET = 1e-4  # world units between a surface and the rays that leave it


@dataclass(frozen=True)
class Part:
    """One surface and its material: radiance = (1 − reflectance)·diffuse + reflectance·reflected.

    With an index of refraction it bounds a clear solid, which lies on the side that its normals point away from, and
    neither `albedo` nor `reflectance` counts. A metal, and a coat over the albedo, reflect by Fresnel's equations, as
    Mitsuba solves them (`path_traced.PathTraced`): `reflectance` does not count there.
    """

    shape: Shape | Mesh
    albedo: Array  # [H, W, 3] linear, upright as the shape's (u, v)
    reflectance: float = 0.0  # share of the light that is reflected, in [0, 1]
    roughness: float = 0.0  # roughness of the reflecting microfacets (GGX, alpha = roughness²); 0 is a mirror
    ior: float = 0.0  # index of refraction of the clear solid behind; 0: opaque
    emission: float = 0.0  # radiance added to the diffuse color, in units of the albedo
    metal: str = ""  # chemical symbol of the metal that it is of
    coat: float = 0.0  # index of refraction of a clear coat; 0: none


@dataclass(frozen=True)
class Hits:
    """What each of R rays hits first."""

    distance: Array  # [R] in units of the direction's length; 0 where nothing is hit
    face: Index  # [R], −1 where nothing is hit
    weights: Array  # [R, 3] barycentric, of the face's corners

    @property
    def met(self) -> NDArray[np.bool_]:
        return self.face >= 0

    def __getitem__(self, rays: Index | NDArray[np.bool_]) -> Hits:
        return Hits(self.distance[rays], self.face[rays], self.weights[rays])


@dataclass
class World:
    """Parts under a sky, in float32 as Embree takes them. `textures` start black: `lighting.bake` fills them."""

    parts: list[Part]
    sky: Array  # [H, W, 3] linear radiance from infinity
    bounces: int = 5  # reflections and refractions followed along one path
    textures: list[Array] = field(init=False)  # outgoing diffuse radiance, one [H, W, 3] a part

    def __post_init__(self) -> None:
        meshes = [tessellate(part.shape) for part in self.parts]
        starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
        self._faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)])
        self.part_of_face = np.concatenate([np.full(len(mesh.faces), i) for i, mesh in enumerate(meshes)])
        self._normals = np.concatenate([mesh.normals for mesh in meshes]).astype(np.float32)
        self._uv = np.concatenate([mesh.uv for mesh in meshes]).astype(np.float32)
        self._embree = EmbreeScene(robust=True)
        vertices = np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float32)
        TriangleMesh(self._embree, vertices, self._faces.astype(np.int32))
        corners = vertices[self._faces]
        self._outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.ior = np.array([part.ior for part in self.parts], dtype=np.float32)
        self.metal = np.array([bool(part.metal) for part in self.parts])
        self.coated = np.array([part.coat > 0 for part in self.parts])
        # the share of the light that is not the surface's own, or 1 where Fresnel's equations say how much it is
        share = np.array([1 if part.ior else part.reflectance for part in self.parts], dtype=np.float32)
        self.specular = np.where(self.metal | self.coated, np.float32(1), share)
        self.roughness = np.array([part.roughness for part in self.parts], dtype=np.float32)
        self.sky = self.sky.astype(np.float32)
        self.set_textures([np.zeros_like(part.albedo) for part in self.parts])

    @property
    def fresnel(self) -> bool:
        """Whether there is a metal or a coat, which Mitsuba alone draws."""
        return bool((self.metal | self.coated).any())

    def set_textures(self, textures: list[Array]) -> None:
        self.textures = textures
        self._texels = np.concatenate([texture.reshape(-1, 3) for texture in textures]).astype(np.float32)
        self._size = np.array([texture.shape[1::-1] for texture in textures], dtype=np.int32)
        self._start = np.cumsum([0] + [texture.shape[0] * texture.shape[1] for texture in textures[:-1]])

    def cast(self, origins: Array, directions: Array) -> Hits:
        """The first hit of each ray o + t·d, t > 0. Rays are [R, 3] each, d of any length."""
        found = self._embree.run(np.ascontiguousarray(origins), np.ascontiguousarray(directions), output=True)
        face, b, c = found["primID"].astype(np.int64), found["u"], found["v"]
        return Hits(np.where(face < 0, np.float32(0), found["tfar"]), face, np.stack([1 - b - c, b, c], axis=1))

    def part(self, hits: Hits) -> Index:
        """The part each ray hit, [R]; any where it hit none. Below, all must have hit one."""
        return self.part_of_face[hits.face]

    def normals(self, hits: Hits, directions: Array) -> Array:
        """Smooth unit normals [R, 3], facing the rays' origins."""
        normals = self._interpolated(self._normals, hits)
        length = np.sqrt(np.einsum("ri,ri->r", normals, normals))
        return normals / np.where(np.einsum("ri,ri->r", normals, directions) > 0, -length, length)[:, None]

    def from_outside(self, hits: Hits, directions: Array) -> NDArray[np.bool_]:
        """Whether each ray comes from the side that the surface's normals point to, [R]."""
        return np.einsum("ri,ri->r", self._outward.take(hits.face, axis=0), directions) < 0

    def diffuse(self, hits: Hits) -> Array:
        """Outgoing diffuse radiance [R, 3]: the parts' textures, bilinear."""
        part = self.part(hits)
        size = self._size[part]
        position = np.clip(self._interpolated(self._uv, hits) * size - np.float32(0.5), 0, size - 1).astype(np.float32)
        low = position.astype(np.int32)
        s, t = (position - low).T[..., None]
        right, below = np.minimum(low + 1, size - 1).T - low.T
        corner = self._start[part] + low[:, 1].astype(np.int64) * size[:, 0] + low[:, 0]
        down = below * size[:, 0]
        take = self._texels.take
        upper = take(corner, axis=0) * (1 - s) + take(corner + right, axis=0) * s
        lower = take(corner + down, axis=0) * (1 - s) + take(corner + down + right, axis=0) * s
        return upper * (1 - t) + lower * t

    def sky_radiance(self, directions: Array) -> Array:
        """Light from infinity along each direction [R, 3], of any length: the nearest texel of the panorama."""
        rows, columns = self.sky.shape[:2]
        x, y, z = directions.T
        azimuth = np.arctan2(y, x) / (2 * np.pi) % 1.0
        colatitude = np.arctan2(np.hypot(x, y), z) / np.pi
        row = np.minimum((colatitude * rows).astype(np.int64), rows - 1)
        column = np.minimum((azimuth * columns).astype(np.int64), columns - 1)
        return self.sky[row, column]

    def seen(self, hits: Hits, directions: Array) -> Array:
        """Radiance [R, 3] that comes back along each ray, reflections left out: diffuse light, or the sky."""
        if hits.met.all():
            return self.diffuse(hits)
        result = np.empty_like(directions)
        result[hits.met] = self.diffuse(hits[hits.met])
        result[~hits.met] = self.sky_radiance(directions[~hits.met])
        return result

    def _interpolated(self, values: Array, hits: Hits) -> Array:
        """Values a vertex, [V, C], at the hits: [R, C]."""
        corners = self._faces.take(hits.face, axis=0)
        a, b, c = (values.take(corners[:, i], axis=0) * hits.weights[:, i, None] for i in range(3))
        return a + b + c


def reflect_directions(directions: Array, normals: Array) -> Array:
    """d − 2(d·n)n for each row."""
    return directions - 2 * np.einsum("ri,ri->r", directions, normals)[:, None] * normals


def tangents(normals: Array) -> tuple[Array, Array]:
    """Two unit vectors [R, 3] that form a right-handed frame with each unit normal."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, np.eye(3, dtype=np.float32)[2], np.eye(3, dtype=np.float32)[0])
    tangent = np.cross(normals, helper)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return tangent, np.cross(normals, tangent)
