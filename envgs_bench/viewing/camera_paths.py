"""Camera paths: where a trained scene is looked at from, a camera a frame.

Cameras are those of the run's scene: its world frame and units, OpenCV axes (x right, y down, z forward). What is
"up" is the mean of the cameras' own: captures stand any way in their worlds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from envgs_bench.core import Camera
from envgs_bench.methods.gaussians.regions import foreground_ball

SPIRAL_TURNS = 2
SPIRAL_SHARE = 0.15  # the spiral's radius, of the distance to what is looked at: 8.5° to either side

Array = NDArray[np.float64]


def orbit(cameras: Sequence[Camera], frames: int) -> list[Camera]:
    """Once around what the cameras look at, at their mean height and distance from the upright axis through it.

    The first frame stands in the direction of the first camera, whose intrinsics all have; after the last comes the
    first again. Where the cameras stand around nothing, as along a street, `spiral` and `interpolate` serve.
    """
    target = foreground_ball(cameras).center.double().numpy()
    up = up_direction(cameras)
    offsets = _centers(cameras) - target
    heights = offsets @ up
    across = offsets - heights[:, None] * up
    radius = np.linalg.norm(across, axis=1).mean()
    first = across[0] / max(np.linalg.norm(across[0]), 1e-12)
    second = np.cross(up, first)
    angles = 2 * np.pi * np.arange(frames) / frames
    around = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
    return [_looking(target + radius * way + heights.mean() * up, target, up, cameras[0]) for way in around]


def spiral(cameras: Sequence[Camera], frames: int) -> list[Camera]:
    """Two turns about the first camera, back and forth along its axis, always toward what the cameras look at.

    LLFF's path for cameras that face one way (Mildenhall et al. 2019), with a radius of 0.15 times the distance to what
    is looked at. After the last frame comes the first again.
    """
    camera, target = cameras[0], looked_at(cameras[0], cameras)
    rotation, center = camera.world_to_camera[:3, :3].double().numpy(), camera.center.double().numpy()
    distance = np.linalg.norm(target - center)
    angles = 2 * np.pi * np.arange(frames) / frames
    steps = [np.sin(SPIRAL_TURNS * angles), np.cos(SPIRAL_TURNS * angles), np.sin(angles)]
    centers = center + SPIRAL_SHARE * distance * np.stack(steps, axis=1) @ rotation
    return [_looking(place, target, -rotation[1], camera) for place in centers]


def interpolate(cameras: Sequence[Camera], frames: int) -> list[Camera]:
    """From the first camera through all others to the last, at the same time from each to the next.

    Centers follow a cubic spline, rotations one of continuous angular acceleration, intrinsics straight lines. The
    first frame is the first camera and the last the last; all are of the first one's size.

    Raises:
        ValueError: there are fewer than two cameras.
    """
    if len(cameras) < 2:
        raise ValueError(f"a path from camera to camera needs two at least, not {len(cameras)}; try orbit or spiral")
    size = cameras[0].width, cameras[0].height
    moments, at = np.arange(len(cameras)), np.linspace(0, len(cameras) - 1, frames)
    poses = np.stack([camera.world_to_camera.double().numpy() for camera in cameras])
    intrinsics = np.stack([camera.resized(*size).intrinsics.double().numpy() for camera in cameras])
    centers = CubicSpline(moments, _centers(cameras), bc_type="natural")(at)
    rotations = RotationSpline(moments, Rotation.from_matrix(poses[:, :3, :3]))(at).as_matrix()
    between = np.stack([np.interp(at, moments, column) for column in intrinsics.reshape(-1, 9).T], axis=1)
    return [
        replace(cameras[0], world_to_camera=_pose(rotation, center), intrinsics=_tensor(values.reshape(3, 3)))
        for rotation, center, values in zip(rotations, centers, between, strict=True)
    ]


PATHS: dict[str, Callable[[Sequence[Camera], int], list[Camera]]] = {
    "orbit": orbit,
    "spiral": spiral,
    "interpolate": interpolate,
}


def looked_at(camera: Camera, cameras: Sequence[Camera]) -> Array:
    """The point [3] on the camera's axis, in the world frame, that is as far ahead as what all `cameras` look at."""
    ball, forward = foreground_ball(cameras), camera.world_to_camera[2, :3].double().numpy()
    center = camera.center.double().numpy()
    ahead = float(forward @ (ball.center.double().numpy() - center))
    return center + (ahead if ahead > 0 else ball.radius) * forward  # behind cameras that look outward


def reframed(camera: Camera, width: int, height: int) -> Camera:
    """The camera with a picture of another size: it sees the same from top to bottom, and more or less at the sides."""
    scale = height / camera.height
    (fx, skew, cx), (_, fy, cy), last = (scale * camera.intrinsics.double()).tolist()
    cx += (width - scale * camera.width) / 2
    intrinsics = _tensor([[fx, skew, cx], [0, fy, cy], [0, 0, last[2] / scale]])
    return replace(camera, intrinsics=intrinsics, width=width, height=height)


def up_direction(cameras: Sequence[Camera]) -> Array:
    """The mean of the cameras' upward axes, a unit vector [3] in the world frame; +z where they cancel out."""
    total = np.sum([-camera.world_to_camera[1, :3].double().numpy() for camera in cameras], axis=0)
    length = float(np.linalg.norm(total))
    return total / length if length > 1e-3 * len(cameras) else np.array([0.0, 0.0, 1.0])


def _looking(center: Array, target: Array, up: Array, like: Camera) -> Camera:
    """A camera at `center` that looks at `target`, with the size and the intrinsics of `like`."""
    forward = (target - center) / np.linalg.norm(target - center)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9:  # straight up or down: any direction is to the right
        right = np.cross(forward, np.eye(3)[np.abs(forward).argmin()])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return replace(like, world_to_camera=_pose(rotation, center))


def _pose(rotation: Array, center: Array) -> torch.Tensor:
    """World to camera [4, 4]."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ center
    return _tensor(pose)


def _tensor(values: object) -> torch.Tensor:
    return torch.tensor(np.asarray(values), dtype=torch.float32)


def _centers(cameras: Sequence[Camera]) -> Array:
    return np.stack([camera.center.double().numpy() for camera in cameras])
