"""Training cameras that are not where structure from motion says, and do not look where it says.

Test cameras and points stay exact: errors without a mean leave the world's frame where it is, so that a test view shows
what it would have shown.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from envgs_bench.core import Camera, Scene, View

# The length of a vector of three normal components of deviation 1 has this mean (Maxwell's distribution).
MEAN_LENGTH = np.sqrt(8 / np.pi)


def turn(scene: Scene, mean_degrees: float, rng: np.random.Generator) -> Scene:
    """Each training camera turned about its own center, around a random axis.

    Normals turn with it: an estimator gives them in the camera's frame, and the wrong pose puts them into the world's.
    """
    from scipy.spatial.transform import Rotation

    vectors = np.radians(mean_degrees) / MEAN_LENGTH * rng.normal(size=(len(scene.train), 3))
    turns = Rotation.from_rotvec(vectors).as_matrix()
    return replace(scene, train=[_turned(view, matrix) for view, matrix in zip(scene.train, turns, strict=True)])


def shift(scene: Scene, mean_share: float, rng: np.random.Generator) -> Scene:
    """Each training camera moved in a random direction, on average by this share of the scene radius."""
    moves = mean_share * scene.radius / MEAN_LENGTH * rng.normal(size=(len(scene.train), 3))
    return replace(scene, train=[_moved(view, move) for view, move in zip(scene.train, moves, strict=True)])


def _turned(view: View, matrix: np.ndarray) -> View:
    """The view with the [3, 3] rotation after its own, in the camera's axes."""
    turned = torch.from_numpy(matrix).to(view.camera.world_to_camera.dtype)
    camera = _with_pose(view.camera, lambda pose: turned.double() @ pose, view.camera.center)
    if view.normal is None:
        return replace(view, camera=camera)
    old, new = view.camera.world_to_camera[:3, :3], camera.world_to_camera[:3, :3]
    return replace(view, camera=camera, normal=view.normal @ (new.T @ old).T.to(view.normal))


def _moved(view: View, move: np.ndarray) -> View:
    center = view.camera.center.double() + torch.from_numpy(move)
    return replace(view, camera=_with_pose(view.camera, lambda pose: pose, center))


def _with_pose(camera: Camera, change: Callable[[torch.Tensor], torch.Tensor], center: torch.Tensor) -> Camera:
    """The camera with a changed rotation [3, 3], at `center` [3]."""
    rotation = change(camera.world_to_camera[:3, :3].double())
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ center.double()
    return replace(camera, world_to_camera=pose.to(camera.world_to_camera.dtype))
