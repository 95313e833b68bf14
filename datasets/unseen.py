"""Cameras where nobody stood: between those that train, and beyond them. Of a traced scene truth is known there too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from envgs_bench.core import Camera

from .toy.cameras import look_at

if TYPE_CHECKING:
    from .toy.world import World

Array = NDArray[np.float64]
Free = Callable[[Array, Array], float]  # from a place, along a unit direction: the length to the first surface, or inf

BETWEEN, BEYOND = PLACES = ("between", "beyond")
STEP = 0.5  # of the training cameras' radius: how far those beyond step back
NEARER = 0.5  # of the way to what it looks at: how far those beyond step forward
CLEAR = 0.5  # of the free length: no camera goes further


def unseen_cameras(cameras: Sequence[Camera], count: int, world: World) -> dict[str, list[Camera]]:
    """`count` cameras each way, by PLACES; nothing where that is 0.

    Args:
        cameras: those that train, in the order in which they were taken.
    """
    if not count:
        return {}

    def free(place: Array, direction: Array) -> float:
        length = float(world.cast(*(each[None].astype(np.float32) for each in (place, direction))).distance[0])
        return length or np.inf

    centers = np.stack([_center(camera) for camera in cameras])
    radius = float(np.linalg.norm(centers - centers.mean(0), axis=1).max())
    return {BETWEEN: between(cameras, count), BEYOND: beyond(cameras, count, radius, free)}


def between(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """`count` cameras half-way from one of these to the next, evenly spread over the order in which they were taken."""
    from scipy.spatial.transform import Rotation, Slerp

    found = []
    for index in _spread(len(cameras) - 1, count):
        first, second = cameras[index], cameras[index + 1]
        turns = Rotation.from_matrix(np.stack([_rotation(first), _rotation(second)]))
        center = (_center(first) + _center(second)) / 2
        pose = np.eye(4)
        pose[:3, :3] = Slerp([0, 1], turns)(0.5).as_matrix()
        pose[:3, 3] = -pose[:3, :3] @ center
        found.append(_posed(first, pose))
    return found


def beyond(cameras: Sequence[Camera], count: int, radius: float, free: Free) -> list[Camera]:
    """`count` cameras outside of where these are, each looking at what one of them has in the middle of its picture.

    By turns one steps forward, `NEARER` of the way, and one back and up, `STEP` of the radius; none goes further than
    `CLEAR` of the free length.

    Args:
        cameras: upright, world z up.
        radius: of these cameras around their middle.
    """
    found = []
    for number, index in enumerate(_spread(len(cameras), count)):
        camera = cameras[index]
        center, forward = _center(camera), _rotation(camera)[2]
        ahead = free(center, forward)
        target = center + (ahead if np.isfinite(ahead) else 2 * radius) * forward
        if number % 2:
            back = np.array([0.0, 0.0, 1.0]) - forward
            direction, length = back / np.linalg.norm(back), STEP * radius
        else:
            direction, length = forward, NEARER * float(np.linalg.norm(target - center))
        place = center + min(length, CLEAR * free(center, direction)) * direction
        found.append(_posed(camera, look_at(place, target)))
    return found


def _spread(length: int, count: int) -> list[int]:
    """`count` indices below the length, evenly spread."""
    return [int((number + 0.5) * length / count) for number in range(count)]


def _rotation(camera: Camera) -> Array:
    return camera.world_to_camera[:3, :3].double().numpy()


def _center(camera: Camera) -> Array:
    return camera.center.double().numpy()


def _posed(camera: Camera, pose: Array) -> Camera:
    """The camera at another pose, world to camera [4, 4]."""
    return replace(camera, world_to_camera=torch.from_numpy(pose).to(camera.world_to_camera.dtype))
