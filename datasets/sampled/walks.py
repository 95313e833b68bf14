"""Walks: where sampled scenes are seen from, as people go about a thing with a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage

from envgs_bench.core import Camera

from ..toy.cameras import look_at
from ..toy.shapes import Array
from ..toy.world import World
from .distribution import CLEARANCE, FEW, FIELD_OF_VIEW, HALF_ORBIT, HAND_HELD, WALKS, between, one_of
from .place import Place

FEWEST = 12  # views
TRIES = 12


@dataclass(frozen=True)
class Walk:
    """Where N cameras stand and what they look at, world frame."""

    centers: Array  # [N, 3]
    targets: Array  # [N, 3]


def drawn_walk(place: Place, views: int, rng: np.random.Generator) -> tuple[str, Walk]:
    """A walk about the place, and its kind: a key of `WALKS`."""
    kind = one_of(rng, WALKS)
    start, far, high = rng.uniform(0, 2 * np.pi), between(rng, place.distance), between(rng, place.height)
    if kind == "few":
        count = max(FEWEST, round(between(rng, FEW) * views))
        angle = start + 2 * np.pi * np.arange(count) / count + rng.normal(0, 0.08, count)
        return kind, _walk(place, angle, far + rng.normal(0, 0.1, count), high + rng.normal(0, 0.15, count), rng)
    step = np.arange(views) / views
    if kind == "half_orbit":
        angle = start + np.radians(between(rng, HALF_ORBIT)) * step
        return kind, _walk(place, angle, far + 0.1 * np.cos(7 * step), high + 0.2 * np.sin(11 * step), rng)
    if kind == "hand_held":
        angle = start + np.radians(between(rng, HAND_HELD)) * step + _smooth(views, 0.12, rng)
        return kind, _walk(place, angle, far + _smooth(views, 0.3, rng), high + _smooth(views, 0.2, rng), rng, 0.12)
    if kind == "uneven":
        low, top = place.height
        rounds = np.floor(3 * step)
        angle = start + 6 * np.pi * step + 0.3 * rounds
        heights = np.array([low, 0.5 * (low + top), top])[np.minimum(rounds, 2).astype(int)]
        return kind, _walk(place, angle, far + 0.1 * rounds, heights + rng.normal(0, 0.05, views), rng)
    return kind, _walk(
        place, start + 2 * np.pi * step, far + 0.1 * np.cos(12 * step), high + 0.15 * np.sin(19 * step), rng
    )


def cameras_of(
    walk: Walk, place: Place, world: World, width: int, height: int, rng: np.random.Generator
) -> list[Camera]:
    """The walk's cameras, those that stand in or by something moved outward, inward and up until they do not."""
    focal = width / (2 * np.tan(np.radians(between(rng, FIELD_OF_VIEW)) / 2))
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float32)
    cameras = []
    for center, target in zip(walk.centers, walk.targets, strict=True):
        for attempt in range(TRIES):
            if _clear(world, center):
                break
            outward = center[:2] - np.array(place.target[:2])
            center = center.copy()
            center[:2] = np.array(place.target[:2]) + outward * (0.93 if attempt % 2 else 1.06)
            center[2] += 0.06
            center = _within(center, place)
        pose = torch.from_numpy(look_at(center, target)).float()
        cameras.append(Camera(pose, intrinsics, width, height))
    return cameras


def _walk(place: Place, angle: Array, far: Array, high: Array, rng: np.random.Generator, shake: float = 0.03) -> Walk:
    centers = np.stack([far * np.cos(angle), far * np.sin(angle), high + 0 * angle], -1)
    centers[:, :2] += place.target[:2]
    centers = np.stack([_within(center, place) for center in centers])
    count = len(centers)
    targets = np.array(place.target) + np.stack([_smooth(count, 0.15, rng) for _ in range(3)], -1)
    return Walk(centers, targets + shake * rng.normal(size=targets.shape))


def _within(center: Array, place: Place) -> Array:
    reach = np.array(place.room) - CLEARANCE
    return np.array([*np.clip(center[:2], -reach, reach), max(center[2], 0.25)])


def _smooth(count: int, size: float, rng: np.random.Generator) -> Array:
    """[count] a slow swing of that standard deviation."""
    swing = ndimage.gaussian_filter1d(rng.normal(size=count + 40), max(count / 12, 2.0))[20 : 20 + count]
    return size * swing / max(float(swing.std()), 1e-9)


def _clear(world: World, center: Array) -> bool:
    """Whether nothing is within `CLEARANCE`."""
    steps = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1]), -1).reshape(-1, 3)
    directions = steps[np.any(steps, axis=1)] / np.linalg.norm(steps[np.any(steps, axis=1)], axis=1, keepdims=True)
    origins = np.broadcast_to(center, directions.shape)
    hits = world.cast(origins.astype(np.float32), directions.astype(np.float32))
    return not (hits.met & (hits.distance < CLEARANCE)).any()
