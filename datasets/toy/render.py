"""Pictures and exact geometry of a World, seen through a Camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envgs_bench.core import Camera

from .color import to_srgb
from .world import OFFSET, World, reflect, tangents

Array = NDArray[np.floating[Any]]

BOUNCES = 5  # reflections followed along one path; the last mirror shows its diffuse colour alone
GOLDEN = (5**0.5 - 1) / 2
LOBE_RAYS = 8  # reflected rays where a sample first meets a rough surface


@dataclass(frozen=True)
class Geometry:
    """What the rays through the pixel centres meet first."""

    depth: Array  # [H, W] camera-frame z; 0 where nothing is hit
    normal: Array  # [H, W, 3] world frame, unit, facing the camera; 0 where nothing is hit
    reflective: NDArray[np.bool_]  # [H, W]
    near_field: NDArray[np.bool_]  # [H, W] reflective, and the mirrored ray meets a surface and not the sky


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


def radiance(world: World, origins: Array, directions: Array, rng: np.random.Generator) -> Array:
    """Linear radiance [R, 3] along rays of unit direction, followed through up to BOUNCES reflections.

    At a surface of reflectance k it is (1 − k)·diffuse + k·(radiance of the reflected ray).
    """
    color = np.zeros((len(origins), 3))
    ray, weight = np.arange(len(origins)), np.ones(len(origins), dtype=np.float32)
    for bounce in range(BOUNCES + 1):
        hits = world.cast(origins, directions)
        reflectance = np.where(hits.met, world.reflectance[world.part(hits)], 0) if bounce < BOUNCES else 0 * weight
        light = world.seen(hits, directions) * (weight * (1 - reflectance))[:, None]
        for channel in range(3):
            color[:, channel] += np.bincount(ray, light[:, channel], minlength=len(color))
        mirrors = np.flatnonzero(reflectance)
        if not mirrors.size:
            break
        roughness = world.roughness[world.part(hits[mirrors])]
        copies = np.where((roughness > 0) & (bounce == 0), LOBE_RAYS, 1)
        weight = np.repeat(weight[mirrors] * reflectance[mirrors] / copies, copies)
        lobe = _lobe_samples(copies, rng)
        mirrors, roughness = np.repeat(mirrors, copies), np.repeat(roughness, copies)
        ray, origins, directions, hits = ray[mirrors], origins[mirrors], directions[mirrors], hits[mirrors]
        normals = world.normals(hits, directions)
        origins = origins + hits.distance[:, None] * directions + OFFSET * normals
        directions = reflect(directions, _microfacets(normals, directions, roughness, lobe))
    return color


def _lobe_samples(copies: NDArray[np.int64], rng: np.random.Generator) -> Array:
    """For each of M rays `copies` many well-spread points of the unit square, one after the other: [Σ copies, 2]."""
    first = np.repeat(np.cumsum(copies) - copies, copies)
    index, count = np.arange(copies.sum()) - first, np.repeat(copies, copies)
    shift = np.repeat(rng.uniform(size=(len(copies), 2)), copies, axis=0)
    share, turn = (index + shift[:, 0]) / count, (index * GOLDEN + shift[:, 1]) % 1
    return np.stack([share, turn], axis=1).astype(np.float32)


def _microfacets(normals: Array, directions: Array, roughness: Array, samples: Array) -> Array:
    """Normals of GGX microfacets (alpha = roughness²) drawn by `samples` [R, 2]; the normals where that is 0.

    A facet that would send the ray below the surface is replaced by the normal.
    """
    rough = np.flatnonzero(roughness)
    n, d = normals[rough], directions[rough]
    share, turn = samples[rough].T[..., None]
    alpha = roughness[rough, None] ** 2
    tangent, bitangent = tangents(n)
    sideways = np.cos(2 * np.pi * turn) * tangent + np.sin(2 * np.pi * turn) * bitangent
    facet = np.sqrt(1 - share) * n + alpha * np.sqrt(share) * sideways  # tan²θ = alpha²·share / (1 − share)
    facet /= np.linalg.norm(facet, axis=1, keepdims=True)
    below = (reflect(d, facet) * n).sum(1) <= 1e-3
    facet[below] = n[below]
    result = normals.copy()
    result[rough] = facet
    return result


def geometry(world: World, camera: Camera) -> Geometry:
    """Depth, normals and regions at the pixel centres, without any averaging."""
    origin, to_direction = _frame(camera)
    y, x = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    pixels = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    directions = _transformed(pixels, to_direction)
    hits = world.cast(np.broadcast_to(origin, directions.shape), directions)
    normals = np.zeros_like(directions)
    normals[hits.met] = world.normals(hits[hits.met], directions[hits.met])
    mirrors = np.flatnonzero(hits.met & (world.reflectance[world.part(hits)] > 0))
    points = origin + hits.distance[mirrors, None] * directions[mirrors] + OFFSET * normals[mirrors]
    mirrored = world.cast(points, reflect(directions[mirrors], normals[mirrors]))
    reflective, near_field = (np.zeros(len(pixels), dtype=np.bool_) for _ in range(2))
    reflective[mirrors] = True
    near_field[mirrors] = mirrored.met
    shape = (camera.height, camera.width)
    return Geometry(
        hits.distance.reshape(shape), normals.reshape(*shape, 3), reflective.reshape(shape), near_field.reshape(shape)
    )


def _transformed(vectors: NDArray[np.float64], matrix: NDArray[np.float64]) -> Array:
    """matrix·v for each row, without BLAS: its threads would wait for work in turns with ours, one pool a view."""
    return np.einsum("ri,ji->rj", vectors, matrix).astype(np.float32)


def _frame(camera: Camera) -> tuple[Array, NDArray[np.float64]]:
    """The camera's centre [3], and the [3, 3] matrix from (x, y, 1) to world directions of camera z = 1."""
    pose, intrinsics = camera.world_to_camera.double().numpy(), camera.intrinsics.double().numpy()
    centre = -pose[:3, :3].T @ pose[:3, 3]
    return centre.astype(np.float32), pose[:3, :3].T @ np.linalg.inv(intrinsics)
