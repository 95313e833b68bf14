"""COLMAP's layout: images/, sparse/0/ with cameras, images and points3D, and masks and normals beside them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import torch
from scipy.spatial.transform import Rotation

from envgs_bench.core import Camera, Placement, Scene, View

from ..errors import DatasetError
from ..split import TEST_EVERY, split_views
from .files import ViewFiles, write_views
from .rotation import exact_rotation


def write_colmap(scene: Scene, root: Path, text: bool) -> dict[str, Any]:
    """Write the scene; the model as text or binary. Returns the source's own settings.

    Images are called <view>.png, so that their order, and with it the split, is the views'. Points have no tracks and
    views no keypoints, as in a model whose features were thrown away. Coordinates are the data's, in float64.

    Raises:
        DatasetError: the split is not every eighth view, or a camera is skewed: neither has a place in this layout.
    """
    views = _in_order(scene)
    model = pycolmap.Reconstruction()
    numbers: dict[tuple[float, ...], int] = {}
    for number, view in enumerate(views, start=1):
        camera_id = _add_camera(model, view, numbers)
        image = pycolmap.Image(name=f"{view.name}.png", camera_id=camera_id, image_id=number)
        model.add_image_with_trivial_frame(image, _pose(view.camera, scene.placement))
    colors = np.round(255 * scene.point_colors.double().numpy()).astype(np.uint8)
    for point, color in zip(scene.placement.points_to_data(scene.points.numpy()), colors, strict=True):
        model.add_point3D(point, pycolmap.Track(), color)
    folder = root / "sparse/0"
    folder.mkdir(parents=True)
    (model.write_text if text else model.write_binary)(str(folder))
    views = _with_normals_or_none(views)
    files = [ViewFiles(view, f"images/{view.name}", view.name, f"normals/{view.name}") for view in views]
    write_views(root, files)
    return {"kind": "colmap", "exact_normals": any(view.normal is not None for view in scene.test)}


def _with_normals_or_none(views: list[View]) -> list[View]:
    """The views, all with normals or none, since a folder of them is complete: 0, unknown, where a view lacks them.

    Test views lack them where the normals are a guess; a reader drops theirs again.
    """
    if all(view.normal is None for view in views):
        return views
    return [view if view.normal is not None else replace(view, normal=torch.zeros(view.image.shape)) for view in views]


def _in_order(scene: Scene) -> list[View]:
    """All views in the order of their images' names, as readers sort them.

    A scene without test views is one for a program that is not to see them, whatever readers make of the names.

    Raises:
        DatasetError: their split is not what a reader will make of the names.
    """
    views = sorted([*scene.train, *scene.test], key=lambda view: f"{view.name}.png")
    if not scene.test:
        return views
    _, test = split_views(views, scene.name)
    if [view.name for view in test] != [view.name for view in scene.test]:
        raise DatasetError(
            f"{scene.name}: its test views are not every {TEST_EVERY}th by name, which COLMAP's layout leaves to its "
            "readers; export it with --format blender, which stores the split"
        )
    return views


def _add_camera(model: pycolmap.Reconstruction, view: View, numbers: dict[tuple[float, ...], int]) -> int:
    """The id of the view's camera, which views of the same intrinsics share."""
    camera = view.camera
    (fx, skew, cx), (_, fy, cy), _ = camera.intrinsics.double().tolist()
    if skew:
        raise DatasetError(f"view {view.name}: its intrinsics have a skew of {skew:g}; COLMAP's PINHOLE has none")
    key = (camera.width, camera.height, fx, fy, cx, cy)
    if key not in numbers:
        numbers[key] = len(numbers) + 1
        model.add_camera_with_trivial_rig(
            pycolmap.Camera(
                camera_id=numbers[key],
                model="PINHOLE",
                width=camera.width,
                height=camera.height,
                params=[fx, fy, cx, cy],
            )
        )
    return numbers[key]


def _pose(camera: Camera, placement: Placement) -> pycolmap.Rigid3d:
    """The camera's pose in the data's coordinates."""
    pose = camera.world_to_camera.double().numpy()
    pose[:3, :3] = exact_rotation(camera.world_to_camera[:3, :3].float().numpy())
    pose = placement.pose_to_data(pose)
    return pycolmap.Rigid3d(pycolmap.Rotation3d(Rotation.from_matrix(pose[:3, :3]).as_quat()), pose[:3, 3])
