"""Captures with a COLMAP model, read by pycolmap: text or binary, any perspective or fisheye camera it knows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pycolmap
import torch

from envgs_bench.core import Scene

from .cache import Draft
from .capture import CaptureSettings, cached_capture, make_views, refuse_missing, require_folder
from .contents import files_in
from .estimator import with_estimated_normals
from .normals import Frame
from .paths import listed, path_below
from .photographs import Photograph, with_siblings
from .pictures import EXTENSIONS
from .pointcloud import PointCloud, point_cloud
from .settings import DatasetError, parse_settings
from .siblings import Siblings, region_folders
from .split import split_views

VERSION = 2  # raise it with every change that alters a scene


class ColmapSettings(CaptureSettings):
    """Settings of `kind: colmap`."""

    kind: Literal["colmap"]
    images: str = "images"  # folder below root
    model: str | None = None  # folder below root; sparse/0, or else sparse, where None
    normals_frame: Frame = "world"  # of normals/; camera: x right, y down, z forward; opengl: x right, y up, z backward


def load_colmap(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """A capture: `root` with its images, its model, and what lies beside them.

        images/…         the photographs; subfolders and extensions as in the model
        sparse/0/        cameras, images and points3D, as .bin or .txt
        masks/…          optional, one an image: region `foreground`, white inside
        masks_<name>/…   optional: region <name>
        normals/…        optional, one an image: rgb = 255·(n/2 + 1/2), or float .npy

    Pictures are undistorted to pinhole cameras, then shrunk by area; intrinsics follow the actual sizes.

    Raises:
        DatasetError: anything missing, unreadable or contradictory; the message names the file or key.
    """
    choice = parse_settings(ColmapSettings, settings)
    root = choice.root
    require_folder(root)
    if not (root / choice.images).is_dir():
        raise DatasetError(f"{root}: has no folder {choice.images}/; name the images' folder with dataset.images=…")
    model = model_folder(choice)
    files = files_in([model, root / choice.images, *region_folders(root).values(), root / "normals"])

    def make(draft: Draft) -> Scene:
        return posed_scene(choice, model, root / choice.images, choice.normals_frame, draft)

    return cached_capture(choice, VERSION, files, cache_dir, make)


def posed_scene(choice: CaptureSettings, folder: Path, images: Path, frame: Frame, draft: Draft) -> Scene:
    """The scene of the photographs in `images` with the model in `folder`."""
    model = read_model(folder)
    cloud = _points(model, folder)
    photographs = with_siblings(_photographs(model, folder, images, choice, draft), choice.root, frame)
    train, test = split_views(make_views(photographs, choice, draft), str(images))
    train = with_estimated_normals(train, choice.normal_estimator, draft)
    return Scene(choice.scene_name, train, test, *cloud, torch.tensor(choice.background))


def model_folder(choice: ColmapSettings) -> Path:
    wanted = [choice.model] if choice.model else ["sparse/0", "sparse"]
    for folder in (choice.root / below for below in wanted):
        if any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return folder
    raise DatasetError(
        f"{choice.root}: no COLMAP model in {' or '.join(wanted)} (cameras, images and points3D, as .bin or .txt); "
        "name its folder with dataset.model=…"
    )


def read_model(folder: Path) -> pycolmap.Reconstruction:
    try:
        return pycolmap.Reconstruction(str(folder))
    except Exception as error:  # pycolmap raises whatever its C++ does
        odd = _not_finite(folder)
        if odd:
            raise DatasetError(f"{odd}: this line holds a number that is not finite; repair or remove it") from error
        raise DatasetError(f"{folder}: cannot be read as a COLMAP model ({error}); export it again") from error


def _not_finite(folder: Path) -> str | None:
    """`file:line` of the first nan or inf in a text model, which pycolmap's reader stops at without saying so."""
    for path in sorted(folder.glob("*.txt")):
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), start=1):
            if not line.startswith("#") and {"nan", "inf"} & {word.lstrip("+-") for word in line.lower().split()}:
                return f"{path}:{number}"
    return None


def _points(model: pycolmap.Reconstruction, folder: Path) -> PointCloud:
    found = [model.points3D[key] for key in sorted(model.points3D)]
    points = np.array([point.xyz for point in found]).reshape(-1, 3)
    return point_cloud(points, np.array([point.color for point in found]).reshape(-1, 3) / 255, folder)


def _photographs(
    model: pycolmap.Reconstruction, folder: Path, images: Path, choice: CaptureSettings, draft: Draft
) -> list[Photograph]:
    """The registered images in the order of their names."""
    registered = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
    if not registered:
        raise DatasetError(f"{folder}: the model has no image with a pose")
    cameras = dict(model.cameras)
    by_stem = Siblings(images)
    result, missing = [], []
    for image in registered:
        path = path_below(images, image.name, folder)
        found = path if path.is_file() else by_stem.find(image.name)
        if found is None:
            missing.append(image.name)
            continue
        pose = np.eye(4)
        pose[:3] = (image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world).matrix()
        camera = cameras[image.camera_id]
        for what, values in (("pose", pose), (f"camera {image.camera_id}", np.asarray(camera.params))):
            if not np.isfinite(values).all():
                raise DatasetError(f"{folder}: the {what} of image {image.name} is not finite; repair or remove it")
        result.append(Photograph(image.name, found, camera, pose))
    refuse_missing(choice, len(registered), missing, folder, draft)
    _note_without_pose(by_stem, result, draft)
    return result


def _note_without_pose(images: Siblings, photographs: list[Photograph], draft: Draft) -> None:
    """Structure from motion leaves out images that it cannot place; that there are some is worth knowing."""
    used = {photograph.path for photograph in photographs}
    others = [path.name for path in images.files if path not in used and path.suffix in EXTENSIONS]
    if others:
        draft.note(
            f"{images.folder}: {len(others)} images have no pose in the model and are left out: {listed(others)}"
        )
