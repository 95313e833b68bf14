"""Where the toy scenes are seen from."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from envgs_bench.core import Camera

from .scenes import Orbit


def cameras_around(orbit: Orbit, count: int, width: int, height: int) -> list[Camera]:
    """`count` cameras evenly spaced on the orbit, looking at its target, principal point in the middle."""
    focal = width / (2 * np.tan(np.radians(orbit.field_of_view_degrees) / 2))
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float32)
    result = []
    for angle in 2 * np.pi * np.arange(count) / count:
        radius = orbit.radius + orbit.radius_swing * np.cos(2 * angle)
        height_above = orbit.height + orbit.height_swing * np.sin(3 * angle)
        center = np.array([radius * np.cos(angle), radius * np.sin(angle), height_above])
        pose = torch.from_numpy(look_at(center, np.array(orbit.target))).float()
        result.append(Camera(pose, intrinsics, width, height))
    return result


def look_at(center: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """World-to-camera [4, 4] of an upright camera (world z up; OpenCV axes) at `center` that looks at `target`."""
    forward = (target - center) / np.linalg.norm(target - center)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ center
    pose[np.abs(pose) < 1e-14] = 0  # cos 90° and the like
    return pose
