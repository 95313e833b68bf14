"""Baked light: each surface's diffuse radiance, from emitters, the sky and a few bounces between surfaces."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from .shapes import Mesh
from .textures import linear_weights
from .world import OFFSET, Part, World, tangents

Array = NDArray[np.floating[Any]]

TEXEL = 0.11  # world units between the places where light is gathered
GATHERED_RAYS = 64
GOLDEN = (5**0.5 - 1) / 2
PASSES = 3  # direct light, then two bounces


def bake(world: World, rng: np.random.Generator) -> None:
    """Sets `world.textures` to outgoing radiance: emission + albedo·E/π with E the irradiance gathered by rays.

    Each pass gathers what the pass before left on the surfaces, so pass n adds light of n − 1 bounces. A reflector
    counts as a diffuse surface here and a clear solid as air. Light thrown by mirrors or gathered by glass (caustics)
    is left out. Being stored on the surface, the result is the same from every side, that is Lambertian.
    """
    if world.ior.any():
        opaque = World([part for part in world.parts if not part.ior], world.sky)
        bake(opaque, rng)
        baked = iter(opaque.textures)
        world.set_textures([np.zeros((1, 1, 3)) if part.ior else next(baked) for part in world.parts])
        return
    places = [_places(part) for part in world.parts]
    counts = np.cumsum([points.shape[0] * points.shape[1] for points, _ in places])[:-1]
    normals = np.concatenate([normals.reshape(-1, 3) for _, normals in places]).astype(np.float32)
    origins = np.concatenate([points.reshape(-1, 3) for points, _ in places]).astype(np.float32) + 10 * OFFSET * normals
    world.set_textures([part.emission * part.albedo for part in world.parts])
    for _ in range(PASSES):
        gathered = np.split(_gather(world, origins, normals, rng), counts)
        grids = [light.reshape(points.shape) for light, (points, _) in zip(gathered, places, strict=True)]
        lit = [
            part.albedo * (part.emission + _smooth(grid, part.albedo.shape[:2]))
            for part, grid in zip(world.parts, grids, strict=True)
        ]
        world.set_textures(lit)


def _places(part: Part) -> tuple[Array, Array]:
    """Points and normals, [rows, columns, 3] each, where light is gathered on a part."""
    assert not isinstance(part.shape, Mesh), "meshes are path-traced, which needs no gathered light"
    columns, rows = (int(np.clip(np.ceil(length / TEXEL), 6, 128)) for length in part.shape.extent)
    v, u = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns, indexing="ij")
    return part.shape.evaluate(u, v)


def _gather(world: World, origins: Array, normals: Array, rng: np.random.Generator) -> Array:
    """E/π at each place: the mean radiance over cosine-distributed directions, [P, 3]."""
    tangent, bitangent = tangents(normals)
    shift = rng.uniform(size=(2, len(origins), 1)).astype(np.float32)

    def toward(index: int) -> Array:
        # a golden-ratio lattice, shifted at random from place to place
        height = (shift[0] + np.float32((index + 0.5) / GATHERED_RAYS)) % 1
        angle = 2 * np.pi * ((shift[1] + np.float32(index * GOLDEN % 1)) % 1)
        directions = np.sqrt(height) * (np.cos(angle) * tangent + np.sin(angle) * bitangent)
        directions += np.sqrt(1 - height) * normals
        return world.seen(world.cast(origins, directions), directions)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return np.mean(list(pool.map(toward, range(GATHERED_RAYS))), axis=0)


def _smooth(grid: Array, shape: tuple[int, int]) -> Array:
    """The gathered light, a little blurred, bilinearly enlarged to the texture's [H, W]."""
    blurred = ndimage.gaussian_filter(grid, (0.7, 0.7, 0), mode="nearest")
    down, across = (
        linear_weights((np.arange(n) + 0.5) / n * m - 0.5, m) for n, m in zip(shape, grid.shape[:2], strict=True)
    )
    return np.einsum("hi,ijc,wj->hwc", down, blurred, across, optimize=True)
