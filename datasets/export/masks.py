"""Mask files: masks of a scene's views, written as the folder beside the images that its source reads."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray
from PIL import Image

from ..blender import TRANSFORMS, BlenderSettings
from ..colmap import ColmapSettings
from ..colmap import model_of as colmap_model
from ..formats.transforms_json import read_frames
from ..paths import path_below
from ..photographs.photograph import Photograph
from ..photographs.undistortion import PINHOLES, undistorted_camera
from ..photos import PhotosSettings, images_of
from ..photos import model_of as photos_model
from ..settings import DatasetError, parse_settings
from ..transforms import TransformsSettings, photographs_of

Mask = NDArray[np.bool_]


def write_masks(settings: Mapping[str, Any], cache_dir: Path, masks: Mapping[str, Mask], folder: Path) -> list[Path]:
    """Write one mask [H, W] a view, by the view's name, to `folder`; the files: PNG, white inside.

    A file has the path of its view's photograph. Where that is a pinhole's, it is the mask as given; where it is
    distorted, the mask is distorted likewise, so that undistorting it gives it back but for its edges. Of a scene
    without photographs it is <view>.png.

    Args:
        settings: the scene's, as for `load_scene`.

    Raises:
        DatasetError: a view has no photograph in the scene's files (any more).
    """
    known = {photograph.view_name: photograph for photograph in _photographs(settings, cache_dir)}
    lost = sorted(set(masks) - set(known)) if known else []
    if lost:
        raise DatasetError(f"{settings.get('root')}: has no photograph of view {lost[0]}; its files have changed")
    paths = []
    for name, mask in masks.items():
        path = folder / f"{name}.png"
        if known:
            path = folder / PurePosixPath(known[name].name).with_suffix(".png")
            mask = _distorted(mask, known[name].camera)
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.where(mask, 255, 0).astype(np.uint8)).save(path)
        paths.append(path)
    return paths


def _photographs(settings: Mapping[str, Any], cache_dir: Path) -> list[Photograph]:
    given = {key: value for key, value in settings.items() if key != "obtain"}
    kind = given["kind"]
    if kind == "colmap":
        capture = parse_settings(ColmapSettings, given)
        return colmap_model(capture).photographs(capture.root / capture.images)[0]
    if kind == "photos":
        photos = parse_settings(PhotosSettings, given)
        images, files = images_of(photos)
        names = [path.relative_to(images).as_posix() for path in files]
        return photos_model(photos, images, names, cache_dir).photographs(images)[0]
    if kind == "transforms":
        posed = parse_settings(TransformsSettings, given)
        return photographs_of(read_frames(path_below(posed.root, posed.file, posed.root)), posed)[0]
    if kind == "blender":
        root = parse_settings(BlenderSettings, given).root
        return [photograph for name in TRANSFORMS for photograph in read_frames(root / name).photographs()[0]]
    return []


def _distorted(mask: Mask, camera: pycolmap.Camera) -> Mask:
    """The mask [H, W] of the pinhole `undistorted_camera(camera)` as `camera` sees it, at the same scale."""
    if camera.model.name in PINHOLES:
        return mask
    x, y = _places(camera.model.name, camera.width, camera.height, tuple(camera.params), mask.shape[1], mask.shape[0])
    return (x >= 0) & mask[y, x]


@lru_cache(maxsize=4)
def _places(
    model: str, width: int, height: int, params: tuple[float, ...], mask_width: int, mask_height: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Column and row in the undistorted mask of each pixel of the distorted one; a column of −1 where it shows none."""
    camera = pycolmap.Camera(model=model, width=width, height=height, params=list(params))
    pinhole = undistorted_camera(camera)
    scale = np.array([mask_width / pinhole.width, mask_height / pinhole.height])
    rows = round(height * scale[1])
    columns = round(width * rows / height)
    y, x = np.mgrid[:rows, :columns] + 0.5
    pixels = np.stack([x * width / columns, y * height / rows], axis=-1).reshape(-1, 2)
    intrinsics = pinhole.calibration_matrix()
    seen = np.asarray(camera.cam_from_img(pixels)) * intrinsics[[0, 1], [0, 1]] + intrinsics[:2, 2]
    places = np.floor(seen * scale).reshape(rows, columns, 2)
    inside = ((places >= 0) & (places < [mask_width, mask_height])).all(axis=-1)  # not where a number is none
    found = np.where(inside[..., None], places, [-1, 0]).astype(np.int32)
    return found[..., 0], found[..., 1]
