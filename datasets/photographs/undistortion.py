"""Undistortion: from any perspective or fisheye camera to a pinhole that sees the same, and for masks back."""

from __future__ import annotations

import threading
from functools import lru_cache

import numpy as np
import pycolmap
from numpy.typing import NDArray

from ..errors import DatasetError

Mask = NDArray[np.bool_]

PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
ROWS_AT_ONCE = 256  # rows of a map made at a time: bounds its memory

_one_at_a_time = threading.Lock()  # threads that want the same map wait for it, instead of making it too


def undistorted_camera(camera: pycolmap.Camera) -> pycolmap.Camera:
    """The pinhole camera that sees what `camera` sees, without borders where there is no picture.

    Raises:
        DatasetError: no pinhole can, as of a panorama.
    """
    if camera.model.name in PINHOLES:
        return camera
    try:
        return pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), camera)
    except Exception as error:  # pycolmap raises whatever its C++ does
        raise DatasetError(
            f"a camera of model {camera.model.name} cannot be undistorted to a pinhole; use a perspective or fisheye "
            "model, as OPENCV or OPENCV_FISHEYE"
        ) from error


def undistort(pixels: NDArray, camera: pycolmap.Camera) -> NDArray[np.float32]:
    """What `undistorted_camera(camera)` sees of the picture [H, W, C] of `camera`'s size; bilinear, [h, w, C]."""
    if camera.model.name in PINHOLES:
        return pixels.astype(np.float32)
    import torch  # which cameras alone do without

    with _one_at_a_time:
        places = _map(camera.model.name, camera.width, camera.height, tuple(camera.params))
    planes = torch.from_numpy(np.ascontiguousarray(pixels, dtype=np.float32)).permute(2, 0, 1)[None]
    seen = torch.nn.functional.grid_sample(
        planes, torch.from_numpy(places)[None], padding_mode="border", align_corners=False
    )
    return seen[0].permute(1, 2, 0).numpy()


@lru_cache(maxsize=4)
def _map(model: str, width: int, height: int, params: tuple[float, ...]) -> NDArray[np.float32]:
    """Where the undistorted camera's pixel centers lie in the picture: [h, w, 2], ±1 at its outer edges."""
    camera = pycolmap.Camera(model=model, width=width, height=height, params=list(params))
    pinhole = undistorted_camera(camera)
    inverse = np.linalg.inv(pinhole.calibration_matrix())
    places = np.empty((pinhole.height, pinhole.width, 2), dtype=np.float32)
    for first in range(0, pinhole.height, ROWS_AT_ONCE):
        y, x = np.mgrid[first : min(first + ROWS_AT_ONCE, pinhole.height), : pinhole.width] + 0.5
        rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ inverse.T
        pixels = camera.img_from_cam(rays).reshape(*x.shape, 2)
        places[first : first + ROWS_AT_ONCE] = 2 * pixels / [width, height] - 1
    return places


def distorted(mask: Mask, camera: pycolmap.Camera) -> Mask:
    """The mask [H, W] of the pinhole `undistorted_camera(camera)` as `camera` sees it, at the same scale."""
    if camera.model.name in PINHOLES:
        return mask
    x, y = _places_seen(
        camera.model.name, camera.width, camera.height, tuple(camera.params), mask.shape[1], mask.shape[0]
    )
    return (x >= 0) & mask[y, x]


@lru_cache(maxsize=4)
def _places_seen(
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
