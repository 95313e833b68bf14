"""Captures: what every source of photographs has in common, from files to views."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pycolmap
import torch
from numpy.typing import NDArray
from pydantic import Field

from envgs_bench.core import Camera, Scene, View

from .cache import Draft, drafted_scene
from .contents import digest_of
from .estimator import estimator_version, with_estimated_normals
from .normals import world_normals
from .paths import listed
from .photographs import Photograph, fit_to_files
from .pictures import read_mask, read_picture
from .pointcloud import PointCloud
from .progress import report
from .resampling import resample
from .settings import DatasetError, SourceSettings
from .split import split_views
from .undistortion import PINHOLES, undistort, undistorted_camera

ALL_OF_IT = 0.999  # of a pixel, in floats
ROUNDING = 1e-14  # of float64 numbers around 1, after some operations

Missing = Literal["refuse", "skip"]
Channel = Annotated[float, Field(ge=0, le=1)]


class CaptureSettings(SourceSettings):
    """Settings of every source of photographs."""

    root: Path
    downsample: Annotated[float, Field(ge=1, allow_inf_nan=False)] = 1.0  # pictures are this many times smaller
    background: tuple[Channel, Channel, Channel] = (0.0, 0.0, 0.0)  # sRGB
    normal_estimator: str | None = None  # package.module:function, for the training views

    @property
    def scene_name(self) -> str:
        return self.name or self.root.resolve().name


def cached_capture(
    settings: CaptureSettings, version: int, files: Iterable[Path], cache_dir: Path, make: Callable[[Draft], Scene]
) -> Scene:
    """The scene that `make` makes of these settings and files, from the cache where both are the same as before.

    Args:
        version: of the source's code.
        files: all that the scene is made from; those that do not exist are left out.
    """
    key = {
        "version": version,
        **settings.model_dump(mode="json", exclude={"root"}),
        "name": settings.scene_name,
        "contents": digest_of((path for path in files if path.is_file()), settings.root, cache_dir),
        "estimator": estimator_version(settings.normal_estimator),
    }
    return drafted_scene(cache_dir, settings.scene_name, key, make)


def files_of(photographs: Iterable[Photograph]) -> list[Path]:
    """The pictures, and the masks and normals that belong to them."""
    return [
        path
        for photograph in photographs
        for path in (
            photograph.path,
            *photograph.masks.values(),
            *([photograph.normal.path] if photograph.normal else []),
        )
    ]


def require_folder(root: Path) -> None:
    if root.is_file():
        raise DatasetError(f"dataset.root={root}: is a file; unpack it and give the folder")
    if not root.is_dir():
        raise DatasetError(f"dataset.root={root}: there is no such folder")


def refuse_missing(how: Missing, named: int, missing: Sequence[str], source: Path, draft: Draft) -> None:
    """Refuse, or else note, that images which `source` names are not there.

    Raises:
        DatasetError: some are missing and the settings do not say to skip them, or all are.
    """
    if not missing:
        return
    text = f"{source}: {len(missing)} of {named} images that it names are not there: {listed(list(missing))}"
    if how == "skip" and len(missing) < named:
        draft.note(f"{text}; left out")
        return
    raise DatasetError(f"{text}; put them back, or name their folder with dataset.images, or set dataset.missing=skip")


def make_scene(
    settings: CaptureSettings, photographs: Sequence[Photograph], cloud: PointCloud, source: Path, draft: Draft
) -> Scene:
    """The scene of these photographs, every eighth of which tests; `source` names them in errors."""
    train, test = split_views(make_views(photographs, settings, draft), str(source))
    train = with_estimated_normals(train, settings.normal_estimator, draft)
    return Scene(settings.scene_name, train, test, *cloud, torch.tensor(settings.background))


def make_views(photographs: Sequence[Photograph], settings: CaptureSettings, draft: Draft) -> list[View]:
    """The photographs as views: upright pinhole pictures with intrinsics of their actual sizes, in the given order.

    Pictures, masks and normals are undistorted, then shrunk by area; all in parallel, each kept in the draft as soon
    as it is there.

    Raises:
        DatasetError: any file that cannot be read or does not fit; the message names it.
    """
    fitted = fit_to_files(photographs, draft)
    views: list[View] = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for view in pool.map(lambda photograph: _make_view(photograph, settings, draft), fitted):
            views.append(view)
            report("reading images", len(views), len(fitted))
    return views


def _make_view(photograph: Photograph, settings: CaptureSettings, draft: Draft) -> View:
    camera = _camera(photograph, settings.downsample)

    def fitted(pixels: NDArray) -> torch.Tensor:
        return torch.from_numpy(_fitted(pixels, photograph.camera, camera))

    picture, opaque = read_picture(photograph.path, settings.background, photograph.turned)
    normal = None
    if photograph.normal is not None:
        vectors = photograph.normal.read(_opaque_at(opaque, *photograph.normal.size()))
        normal = draft.keep(world_normals(fitted(vectors), camera, photograph.normal.frame))
    return View(
        name=photograph.view_name,
        camera=camera,
        image=draft.keep(fitted(picture)),
        masks={region: draft.keep(fitted(read_mask(path))) for region, path in photograph.masks.items()},
        normal=normal,
    )


def _camera(photograph: Photograph, downsample: float) -> Camera:
    try:
        pinhole = undistorted_camera(photograph.camera)
        width, height = (max(1, round(length / downsample)) for length in (pinhole.width, pinhole.height))
        pose = torch.from_numpy(_without_noise(photograph.world_to_camera)).float()
        intrinsics = torch.from_numpy(np.array(pinhole.calibration_matrix())).float()
        return Camera(pose, intrinsics, pinhole.width, pinhole.height).resized(width, height)
    except ValueError as error:
        raise DatasetError(f"{photograph.name}: {error}; repair or remove it") from error


def _without_noise(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pose with zeros where a quaternion or an inverse left some 1e-16: a camera keeps its bits in a file."""
    return np.where(np.abs(pose) < ROUNDING * np.abs(pose).max(), 0.0, pose)


def _fitted(pixels: NDArray, distorted: pycolmap.Camera, camera: Camera) -> NDArray:
    """Pixels of the whole photograph, of any size, as `camera` sees them: [H, W] or [H, W, C], of the same dtype."""
    planes = pixels if pixels.ndim == 3 else pixels[..., None]
    if distorted.model.name not in PINHOLES:
        planes = undistort(_at_size(planes, distorted.width, distorted.height), distorted)
    planes = _at_size(planes, camera.width, camera.height)
    if pixels.dtype == np.bool_:
        planes = planes >= 0.5
    elif pixels.dtype == np.uint8:
        planes = np.round(planes)
    return np.array(planes, dtype=pixels.dtype).reshape(camera.height, camera.width, *pixels.shape[2:])


def _at_size(planes: NDArray, width: int, height: int) -> NDArray:
    return planes if planes.shape[:2] == (height, width) else resample(planes, width, height)


def _opaque_at(opaque: NDArray[np.bool_] | None, width: int, height: int) -> NDArray[np.bool_] | None:
    """Where every part of a pixel of that size is opaque."""
    return None if opaque is None else _at_size(opaque[..., None], width, height)[..., 0] >= ALL_OF_IT
