"""Photographs of a corner: two walls and a floor with textures, ray cast, from an arc around it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pycolmap
from scipy import ndimage

WIDTH, HEIGHT, FOCAL = 240, 180, 220.0
PINHOLE = pycolmap.Camera(model="PINHOLE", width=WIDTH, height=HEIGHT, params=[FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2])


@cache
def texture(seed: int) -> np.ndarray:
    """Blobs of several sizes, [512, 512, 3] bytes."""
    rng = np.random.default_rng(seed)
    layers = [ndimage.gaussian_filter(rng.uniform(-1, 1, (512, 512, 3)), (s, s, 0), mode="wrap") * s for s in (2, 5)]
    return (127 + 160 * sum(layers)).clip(0, 255).astype(np.uint8)


def look(index: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotation of the world into the camera, and the camera's center: on an arc around the corner."""
    angle = 0.5 + 0.09 * index
    center = np.array([3.2 * np.cos(angle), 3.2 * np.sin(angle), 1.6 + 0.1 * np.sin(2.0 * index)])
    forward = np.array([0.3, 0.3, 0.5]) - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return rotation, center


def photograph(index: int, camera: pycolmap.Camera = PINHOLE) -> np.ndarray:
    """The corner as `camera` sees it, [H, W, 3] bytes: planes x = 0, y = 0 and z = 0, each with a texture."""
    rotation, center = look(index)
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    flat = np.asarray(camera.cam_from_img(np.stack([x, y], axis=-1).reshape(-1, 2)))
    rays = np.column_stack([flat, np.ones(len(flat))]).reshape(*x.shape, 3) @ rotation
    with np.errstate(divide="ignore"):
        distances = np.where(rays < 0, -center / rays, np.inf)
    wall = distances.argmin(axis=-1)
    hit = center + distances.min(axis=-1)[..., None] * rays
    picture = np.zeros((*x.shape, 3), dtype=np.uint8)
    for axis in range(3):
        shown = wall == axis
        at = [np.mod(90 * hit[shown][:, other], 512) for other in range(3) if other != axis]
        planes = texture(axis).astype(float).transpose(2, 0, 1)
        drawn = [ndimage.map_coordinates(plane, at, order=1, mode="grid-wrap") for plane in planes]
        picture[shown] = np.stack(drawn, axis=-1).astype(np.uint8)
    return picture
