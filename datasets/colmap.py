"""Captures with a COLMAP model, read by pycolmap: text or binary, any perspective or fisheye camera it knows."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

import numpy as np
import pycolmap
import torch
from numpy.typing import NDArray
from pydantic import Field

from envgs_bench.core import Camera, Scene, View

from .cache import cached_scene
from .photographs import Siblings, read_mask, read_picture, shrink, undistort, undistorted_camera
from .settings import DatasetError, SourceSettings, parse_settings
from .split import split_views

VERSION = 1  # raise it with every change that alters a scene
NAMED_AT_MOST = 5  # files in an error
LEAST_NORMAL = 0.5  # shorter ones, as of grey pixels, are unknown

Channel = Annotated[float, Field(ge=0, le=1)]


class ColmapSettings(SourceSettings):
    """Settings of `kind: colmap`."""

    kind: Literal["colmap"]
    root: Path
    images: str = "images"  # folder below root
    model: str | None = None  # folder below root; sparse/0, or else sparse, where None
    downsample: Annotated[float, Field(ge=1, allow_inf_nan=False)] = 1.0  # pictures are this many times smaller
    normals_frame: Literal["world", "camera"] = "world"  # of normals/; camera axes as OpenCV's
    background: tuple[Channel, Channel, Channel] = (0.0, 0.0, 0.0)  # sRGB


@dataclass(frozen=True)
class Photograph:
    """One registered image of the model."""

    name: str  # as in the model: path below the images' folder
    path: Path
    camera: pycolmap.Camera  # as in the model, distorted
    world_to_camera: NDArray[np.float64]  # [4, 4]


def load_colmap(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """A capture: `root` with its images, its model, and what lies beside them.

        images/…         the photographs; subfolders and extensions as in the model
        sparse/0/        cameras, images and points3D, as .bin or .txt
        masks/…          optional, one an image: region `foreground`, white inside
        masks_<name>/…   optional: region <name>
        normals/…        optional, one an image: rgb = 255·(n/2 + 1/2)

    Pictures are undistorted to pinhole cameras, then shrunk by area; intrinsics follow the actual sizes.

    Raises:
        DatasetError: anything missing, unreadable or contradictory; the message names the file or key.
    """
    choice = parse_settings(ColmapSettings, settings)
    root = choice.root
    if not root.is_dir():
        raise DatasetError(f"dataset.root={root}: there is no such folder")
    if not (root / choice.images).is_dir():
        raise DatasetError(f"{root}: has no folder {choice.images}/; name the images' folder with dataset.images=…")
    name = choice.name or root.resolve().name
    key = {
        "source": "colmap",
        "version": VERSION,
        **choice.model_dump(mode="json"),
        "name": name,
        "files": _fingerprint([_model_folder(choice), root / choice.images, *_region_folders(root).values()]),
        "normals": _fingerprint([root / "normals"]),
    }
    return cached_scene(cache_dir, name, key, lambda: _make(choice, name))


def _make(choice: ColmapSettings, name: str) -> Scene:
    folder = _model_folder(choice)
    model = _read_model(folder)
    points, colors = _points(model, folder)
    photographs = _photographs(model, folder, choice.root / choice.images)
    regions = {region: Siblings(path) for region, path in _region_folders(choice.root).items()}
    normals = Siblings(choice.root / "normals") if (choice.root / "normals").is_dir() else None
    for siblings in [*regions.values(), *([normals] if normals else [])]:
        _check_complete(siblings, photographs)

    def make_view(photograph: Photograph) -> View:
        return _view(photograph, choice, regions, normals)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        views = list(pool.map(make_view, photographs))
    train, test = split_views(views, str(choice.root / choice.images))
    return Scene(name, train, test, points, colors, torch.tensor(choice.background))


def _model_folder(choice: ColmapSettings) -> Path:
    wanted = [choice.model] if choice.model else ["sparse/0", "sparse"]
    for folder in (choice.root / below for below in wanted):
        if any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return folder
    raise DatasetError(
        f"{choice.root}: no COLMAP model in {' or '.join(wanted)} (cameras, images and points3D, as .bin or .txt); "
        "name its folder with dataset.model=…"
    )


def _region_folders(root: Path) -> dict[str, Path]:
    folders = {"foreground": root / "masks"}
    folders |= {path.name.removeprefix("masks_"): path for path in sorted(root.glob("masks_?*"))}
    return {region: path for region, path in folders.items() if path.is_dir()}


def _fingerprint(folders: list[Path]) -> list[list[Any]]:
    """Path, size and time of change of every file below the folders."""
    files = [path for folder in folders for path in sorted(folder.rglob("*")) if path.is_file()]
    return [[str(path), path.stat().st_size, path.stat().st_mtime_ns] for path in files]


def _read_model(folder: Path) -> pycolmap.Reconstruction:
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


def _points(model: pycolmap.Reconstruction, folder: Path) -> tuple[torch.Tensor, torch.Tensor]:
    found = [model.points3D[key] for key in sorted(model.points3D)]
    if not found:
        raise DatasetError(f"{folder}: the model has no points; triangulate them (colmap point_triangulator)")
    points = np.stack([point.xyz for point in found])
    if not np.isfinite(points).all():
        raise DatasetError(f"{folder}: {np.sum(~np.isfinite(points).all(1))} of {len(points)} points are not finite")
    colors = np.stack([point.color for point in found]) / 255
    return torch.from_numpy(points).float(), torch.from_numpy(colors).float()


def _photographs(model: pycolmap.Reconstruction, folder: Path, images: Path) -> list[Photograph]:
    """The registered images in the order of their names."""
    registered = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
    if not registered:
        raise DatasetError(f"{folder}: the model has no image with a pose")
    by_stem = Siblings(images)
    result, missing = [], []
    for image in registered:
        path = images / image.name
        found = path if path.is_file() else by_stem.find(image.name)
        if found is None:
            missing.append(image.name)
            continue
        pose = np.eye(4)
        pose[:3] = (image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world).matrix()
        camera = model.cameras[image.camera_id]
        for what, values in (("pose", pose), (f"camera {image.camera_id}", np.asarray(camera.params))):
            if not np.isfinite(values).all():
                raise DatasetError(f"{folder}: the {what} of image {image.name} is not finite; repair or remove it")
        result.append(Photograph(image.name, found, camera, pose))
    if missing:
        raise DatasetError(
            f"{images}: {len(missing)} of {len(registered)} images of the model in {folder} are not there: "
            f"{_listed(missing)}; put them back, or remove them from the model, or set dataset.images"
        )
    return result


def _check_complete(siblings: Siblings, photographs: list[Photograph]) -> None:
    missing = [photograph.name for photograph in photographs if siblings.find(photograph.name) is None]
    if missing:
        raise DatasetError(
            f"{siblings.folder}: holds no file for {len(missing)} of {len(photographs)} images: {_listed(missing)}; "
            "add them, or move the folder away"
        )


def _listed(names: list[str]) -> str:
    return ", ".join(names[:NAMED_AT_MOST]) + (" …" if len(names) > NAMED_AT_MOST else "")


def _view(
    photograph: Photograph, choice: ColmapSettings, regions: Mapping[str, Siblings], normals: Siblings | None
) -> View:
    picture = read_picture(photograph.path, choice.background)
    height, width = picture.shape[:2]
    distorted = _at_size(photograph, width, height)
    pinhole = undistorted_camera(distorted)
    small = [max(1, round(length / choice.downsample)) for length in (pinhole.width, pinhole.height)]

    def fitted(pixels: NDArray[np.uint8], path: Path) -> NDArray[np.uint8]:
        if pixels.shape[:2] != (height, width):
            raise DatasetError(
                f"{path}: is {pixels.shape[1]}×{pixels.shape[0]} pixels, its image {photograph.path.name} is "
                f"{width}×{height}; make them one size"
            )
        return shrink(undistort(pixels, distorted), small[0], small[1])

    pose = torch.from_numpy(photograph.world_to_camera).float()
    intrinsics = torch.from_numpy(np.array(pinhole.calibration_matrix())).float()
    try:
        camera = Camera(pose, intrinsics, pinhole.width, pinhole.height).resized(small[0], small[1])
    except ValueError as error:
        raise DatasetError(f"{photograph.name}: {error}; repair or remove it in the model") from error
    mask_paths = {region: siblings.find(photograph.name) for region, siblings in regions.items()}
    normal_path = normals.find(photograph.name) if normals else None
    return View(
        name=PurePosixPath(photograph.name).with_suffix("").as_posix().replace("/", "_"),
        camera=camera,
        image=torch.from_numpy(fitted(picture, photograph.path).copy()),
        masks={
            region: torch.from_numpy(fitted(read_mask(path), path) >= 128)
            for region, path in mask_paths.items()
            if path is not None
        },
        normal=None
        if normal_path is None
        else _normals(fitted(read_picture(normal_path, (0.5, 0.5, 0.5)), normal_path), camera, choice.normals_frame),
    )


def _at_size(photograph: Photograph, width: int, height: int) -> pycolmap.Camera:
    """The photograph's camera at the actual size of its file, which may be a reduced copy."""
    camera = copy.deepcopy(photograph.camera)
    if (width, height) == (camera.width, camera.height):
        return camera
    if abs(width - camera.width * height / camera.height) > 1:
        raise DatasetError(
            f"{photograph.path}: is {width}×{height} pixels, its camera in the model {camera.width}×{camera.height}: "
            "not the same shape; use the images the model was made from, or copies of them reduced as a whole"
        )
    camera.rescale(width, height)
    return camera


def _normals(encoded: NDArray[np.uint8], camera: Camera, frame: str) -> torch.Tensor:
    """World-frame unit normals [H, W, 3] that face the camera, 0 where unknown."""
    normals = torch.from_numpy(encoded.astype(np.float32)) / 127.5 - 1
    if frame == "camera":
        normals = normals @ camera.world_to_camera[:3, :3]
    length = normals.norm(dim=-1, keepdim=True)
    unit = torch.where(length < LEAST_NORMAL, torch.zeros_like(normals), normals / length.clamp(min=LEAST_NORMAL))
    away = (unit * camera.rays()[1]).sum(-1, keepdim=True) > 0
    return torch.where(away, -unit, unit)
