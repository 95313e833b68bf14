"""NeRF's blender layout: transforms_train.json and transforms_test.json, train/ and test/ with RGB pictures."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from plyfile import PlyData, PlyElement

from envgs_bench.core import Camera, Placement, Scene, View

from ..errors import DatasetError
from ..formats.transforms_json import OPENGL_TO_OPENCV
from ..sources.blender import POINTS
from .files import ViewFiles, write_views


def write_blender(scene: Scene, root: Path) -> dict[str, Any]:
    """Write the scene; returns the source's own settings.

    A view lies in train/<view>.png or test/<view>.png, its normals beside it as <view>_normal.npy; read back, its name
    begins with train_ or test_. Points are in points3d.ply. Coordinates are the data's, in float64.

    Raises:
        DatasetError: a camera is skewed: the layout has no place for it.
    """
    root.mkdir(parents=True)
    files = []
    for split, views in (("train", scene.train), ("test", scene.test)):
        names = [f"{split}/{stem}" for stem in _stems(views, split)]
        frames = [_frame(view, name, scene.placement) for view, name in zip(views, names, strict=True)]
        content = {**_shared([*scene.train, *scene.test]), "frames": frames}
        (root / f"transforms_{split}.json").write_text(json.dumps(content, indent=2), encoding="utf-8")
        files += [ViewFiles(view, name, name, f"{name}_normal") for view, name in zip(views, names, strict=True)]
    write_views(root, files)
    _write_points(root / POINTS, scene)
    return {"kind": "blender", "train_normals": any(view.normal is not None for view in scene.train)}


def _stems(views: list[View], split: str) -> list[str]:
    """File names of the views, without what reading them back puts before each."""
    prefix = f"{split}_"
    if all(view.name.startswith(prefix) for view in views):
        return [view.name.removeprefix(prefix) for view in views]
    return [view.name for view in views]


def _shared(views: list[View]) -> dict[str, Any]:
    """camera_angle_x for readers that look for it here alone, where it says all of every view's intrinsics."""
    angles = {_angle(view.camera) for view in views}
    return {"camera_angle_x": angles.pop()} if len(angles) == 1 and None not in angles else {}


def _frame(view: View, name: str, placement: Placement) -> dict[str, Any]:
    camera = view.camera
    (fx, skew, cx), (_, fy, cy), _ = camera.intrinsics.double().tolist()
    if skew:
        raise DatasetError(f"view {view.name}: its intrinsics have a skew of {skew:g}; transforms.json has none")
    to_world = np.linalg.inv(placement.pose_to_data(camera.world_to_camera.double().numpy())) @ OPENGL_TO_OPENCV
    frame: dict[str, Any] = {"file_path": f"./{name}", "transform_matrix": to_world.tolist()}
    if _angle(camera) is None:
        return {**frame, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": camera.width, "h": camera.height}
    return {**frame, "camera_angle_x": _angle(camera)}


def _angle(camera: Camera) -> float | None:
    """The horizontal field of view, radians; None where pixels are not square or the axis is not in the middle."""
    (fx, _, cx), (_, fy, cy), _ = camera.intrinsics.double().tolist()
    if fx != fy or (cx, cy) != (camera.width / 2, camera.height / 2):
        return None
    return 2 * math.atan(camera.width / 2 / fx)


def _write_points(path: Path, scene: Scene) -> None:
    """Positions as float32, of a world that was moved as float64; colors as bytes where that loses nothing."""
    points, colors = scene.placement.points_to_data(scene.points.numpy()), scene.point_colors.float().numpy()
    as_bytes = np.round(255 * colors.astype(np.float64)).astype(np.uint8)
    if np.array_equal((as_bytes / 255).astype(np.float32), colors):
        colors = as_bytes
    color_type = "u1" if colors.dtype == np.uint8 else "f4"
    position_type = "f8" if any(scene.placement.shift) else "f4"
    fields = [(axis, position_type) for axis in "xyz"] + [(channel, color_type) for channel in ("red", "green", "blue")]
    vertices = np.empty(len(points), dtype=fields)
    for index, (axis, channel) in enumerate(zip("xyz", ("red", "green", "blue"), strict=True)):
        vertices[axis], vertices[channel] = points[:, index], colors[:, index]
    PlyData([PlyElement.describe(vertices, "vertex")]).write(str(path))
