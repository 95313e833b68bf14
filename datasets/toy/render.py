"""Pictures and exact geometry of a World, seen through a Camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envgs_bench.core import Camera

from ..formats.srgb import to_srgb
from .paths import radiance
from .world import OFFSET, World, reflect_directions

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Geometry:
    """What the rays through the pixel centers hit first."""

    depth: Array  # [H, W] camera-frame z; 0 where nothing is hit
    normal: Array  # [H, W, 3] world frame, unit, facing the camera; 0 where nothing is hit
    regions: dict[str, NDArray[np.bool_]]  # [H, W] each


def picture(world: World, camera: Camera, supersampling: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """The view [H, W, 3], sRGB. A pixel is its area's mean of linear light, over supersampling² stratified rays."""
    origin, to_direction = _frame(camera)
    total = np.zeros((camera.height * camera.width, 3), dtype=np.float32)
    y, x = np.meshgrid(np.arange(camera.height), np.arange(camera.width), indexing="ij")
    for row in range(supersampling):
        for column in range(supersampling):
            jitter = rng.uniform(size=(2, camera.height, camera.width))
            pixel = np.stack(
                [x + (column + jitter[0]) / supersampling, y + (row + jitter[1]) / supersampling, np.ones(x.shape)], -1
            )
            directions = _transformed(pixel.reshape(-1, 3), to_direction)
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            total += radiance(world, np.broadcast_to(origin, directions.shape), directions, rng)
    mean = total.reshape(camera.height, camera.width, 3) / supersampling**2
    return np.round(255 * to_srgb(mean)).astype(np.uint8)


def geometry(world: World, camera: Camera) -> Geometry:
    """Depth, normals and regions at the pixel centers, without any averaging.

    `reflective` are mirrors, metals, coats and clear solids; `near_field` those whose mirrored ray hits a surface and
    not the sky. Where the world has such things, `transmissive` are clear solids, `mirror` metals, `coated` what is
    under a coat, and `diffuse` is every surface that is not reflective.
    """
    origin, to_direction = _frame(camera)
    y, x = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    pixels = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    directions = _transformed(pixels, to_direction)
    hits = world.cast(np.broadcast_to(origin, directions.shape), directions)
    normals = np.zeros_like(directions)
    normals[hits.met] = world.normals(hits[hits.met], directions[hits.met])
    mirrors = np.flatnonzero(hits.met & (world.specular[world.part(hits)] > 0))
    points = origin + hits.distance[mirrors, None] * directions[mirrors] + OFFSET * normals[mirrors]
    mirrored = world.cast(points, reflect_directions(directions[mirrors], normals[mirrors]))
    near = np.zeros(len(pixels), dtype=np.bool_)
    near[mirrors] = mirrored.met
    part = world.part(hits)
    regions = {"reflective": hits.met & (world.specular[part] > 0), "near_field": near}
    if world.ior.any():
        regions["transmissive"] = hits.met & (world.ior[part] > 0)
    if world.fresnel:
        regions["mirror"] = hits.met & world.metal[part]
        regions["coated"] = hits.met & world.coated[part]
        regions["diffuse"] = hits.met & ~regions["reflective"]
    shape = (camera.height, camera.width)
    masks = {name: region.reshape(shape) for name, region in regions.items()}
    return Geometry(hits.distance.reshape(shape), normals.reshape(*shape, 3), masks)


def _transformed(vectors: NDArray[np.float64], matrix: NDArray[np.float64]) -> Array:
    """matrix·v for each row, without BLAS: its threads would wait for work in turns with ours, one pool a view."""
    return np.einsum("ri,ji->rj", vectors, matrix).astype(np.float32)


def _frame(camera: Camera) -> tuple[Array, NDArray[np.float64]]:
    """The camera's center [3], and the [3, 3] matrix from (x, y, 1) to world directions of camera z = 1."""
    pose, intrinsics = camera.world_to_camera.double().numpy(), camera.intrinsics.double().numpy()
    center = -pose[:3, :3].T @ pose[:3, 3]
    return center.astype(np.float32), pose[:3, :3].T @ np.linalg.inv(intrinsics)
