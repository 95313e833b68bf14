"""Poses: whether views were taken from several places."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from envgs_bench.core import View

from ..errors import DatasetError, listed
from ..notes import note

FEW = 3  # views, of which two at one place say nothing
SAME = 1e-5  # of the largest coordinate: float32's rounding


def check_poses(where: str, views: Sequence[View]) -> None:
    """Refuse views that all have one pose, and note those that share one, or that all stand at one place.

    Raises:
        DatasetError: there are three and more, and they have one pose.
    """
    if len(views) < FEW:
        return
    poses = np.stack([view.camera.world_to_camera.cpu().double().numpy() for view in views])
    unit = SAME * max(1.0, float(np.abs(poses[:, :3, 3]).max()))
    if np.ptp(poses, axis=0).max() <= unit:
        raise DatasetError(
            f"{where}: all {len(views)} views have one pose (as {listed([view.name for view in views])}): nothing "
            "tells how far things are. Write each image's own pose (transform_matrix, or the line of images.txt)"
        )
    alike: dict[bytes, list[str]] = {}
    for view, pose in zip(views, poses, strict=True):
        alike.setdefault(pose.tobytes(), []).append(view.name)
    twice = [name for names in alike.values() if len(names) > 1 for name in names]
    if twice:
        note(
            f"{where}: {len(twice)} of {len(views)} views have exactly the pose of another one: {listed(twice)}; check "
            "that each has its own"
        )
    centers = -np.einsum("vji,vj->vi", poses[:, :3, :3], poses[:, :3, 3])
    if not twice and np.ptp(centers, axis=0).max() <= unit:
        note(
            f"{where}: all {len(views)} views are taken from one place, by turning the camera: nothing tells how far "
            "things are. Check that poses are camera to world (transforms.json) or world to camera (COLMAP)"
        )
