"""Light paths through a World: mirrors, glossy coats and clear solids, until a diffuse surface or the sky."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .dielectric import fresnel, refract
from .world import OFFSET, Hits, World, reflect_directions, tangents

Array = NDArray[np.floating[Any]]
Index = NDArray[np.int64]

GOLDEN = (5**0.5 - 1) / 2
LOBE_RAYS = 8  # reflected rays where a sample first hits a rough surface
MIN_WEIGHT = 1e-4  # share of the light below which a path through glass ends


@dataclass(frozen=True)
class Rays:
    """R rays on their way, each a part of the light of one of the first rays."""

    first: Index  # [R] which of the first rays this one came from
    weight: Array  # [R] share of that ray's light
    origins: Array  # [R, 3]
    directions: Array  # [R, 3] unit

    def __getitem__(self, rays: Index | NDArray[np.bool_]) -> Rays:
        return Rays(self.first[rays], self.weight[rays], self.origins[rays], self.directions[rays])


def radiance(world: World, origins: Array, directions: Array, rng: np.random.Generator) -> Array:
    """Linear radiance [R, 3] along rays of unit direction, followed through up to `world.bounces` surfaces.

    At a surface of reflectance k it is (1 − k)·diffuse + k·(radiance of the reflected ray); at a clear solid
    F·(radiance of the reflected ray) + (1 − F)·(radiance of the refracted ray), F by Fresnel's equations. The last
    mirror on a path shows its diffuse color alone, the last glass is black.
    """
    color = np.zeros((len(origins), 3))
    rays = Rays(np.arange(len(origins)), np.ones(len(origins), dtype=np.float32), origins, directions)
    for bounce in range(world.bounces + 1):
        hits = world.cast(rays.origins, rays.directions)
        part = world.part(hits)
        specular = np.where(hits.met, world.specular[part], 0) if bounce < world.bounces else 0 * rays.weight
        light = world.seen(hits, rays.directions) * (rays.weight * (1 - specular))[:, None]
        for channel in range(3):
            color[:, channel] += np.bincount(rays.first, light[:, channel], minlength=len(color))
        clear = world.ior[part] > 0
        mirrors, glass = np.flatnonzero((specular > 0) & ~clear), np.flatnonzero((specular > 0) & clear)
        if not mirrors.size + glass.size:
            break
        spread = LOBE_RAYS if bounce == 0 else 1
        following = [_mirrored(world, rays[mirrors], hits[mirrors], spread, rng)] if mirrors.size else []
        following += _at_glass(world, rays[glass], hits[glass]) if glass.size else []
        rays = _joined(following)
    return color


def _mirrored(world: World, rays: Rays, hits: Hits, spread: int, rng: np.random.Generator) -> Rays:
    """The reflected rays: one from a mirror, `spread` many from a rough surface."""
    part = world.part(hits)
    copies = np.where(world.roughness[part] > 0, spread, 1)
    weight = np.repeat(rays.weight * world.specular[part] / copies, copies)
    lobe = _lobe_samples(copies, rng)
    again = np.repeat(np.arange(len(copies)), copies)
    rays, hits, roughness = rays[again], hits[again], world.roughness[part][again]
    normals = world.normals(hits, rays.directions)
    origins = rays.origins + hits.distance[:, None] * rays.directions + OFFSET * normals
    directions = reflect_directions(rays.directions, _microfacets(normals, rays.directions, roughness, lobe))
    return Rays(rays.first, weight, origins, directions)


def _at_glass(world: World, rays: Rays, hits: Hits) -> list[Rays]:
    """The reflected and the refracted rays at clear solids, those of little weight left out."""
    ior = world.ior[world.part(hits)]
    ratio = np.where(world.from_outside(hits, rays.directions), 1 / ior, ior)
    normals = world.normals(hits, rays.directions)
    reflected = fresnel(-np.einsum("ri,ri->r", rays.directions, normals), ratio)
    points = rays.origins + hits.distance[:, None] * rays.directions
    both = [
        Rays(
            rays.first, rays.weight * reflected, points + OFFSET * normals, reflect_directions(rays.directions, normals)
        ),
        Rays(
            rays.first,
            rays.weight * (1 - reflected),
            points - OFFSET * normals,
            refract(rays.directions, normals, ratio),
        ),
    ]
    return [part[part.weight > MIN_WEIGHT] for part in both]


def _joined(parts: list[Rays]) -> Rays:
    if len(parts) == 1:
        return parts[0]
    fields = [(rays.first, rays.weight, rays.origins, rays.directions) for rays in parts]
    return Rays(*(np.concatenate(arrays) for arrays in zip(*fields, strict=True)))


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
    below = (reflect_directions(d, facet) * n).sum(1) <= 1e-3
    facet[below] = n[below]
    result = normals.copy()
    result[rough] = facet
    return result
