"""Views: photographs as methods want them, upright pinhole pictures with intrinsics of their actual sizes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pycolmap
import torch
from numpy.typing import NDArray

from envgs_bench.core import Camera, View

from ..errors import DatasetError
from ..formats.masks import Coding, mask_codings, read_mask
from ..formats.normal_maps import world_normals
from ..formats.photograph import Photograph
from ..formats.pictures import Color, read_picture
from ..progress import streamed
from .exposure import brightened
from .resampling import resample
from .undistortion import PINHOLES, undistort, undistorted_camera

OPAQUE_SHARE = 0.999  # share of a pixel that counts as all of it: floats do not add up to 1
ROUNDING = 1e-14  # relative error of float64 numbers after some operations


def read_views(
    photographs: Sequence[Photograph], downsample: float, background: Color, mask_labels: Sequence[int | str] = ()
) -> Iterator[View]:
    """The photographs as views, in the given order, one after the other while others are read in parallel.

    Pictures, masks and normals are undistorted, then shrunk by area.

    Args:
        photographs: fitted to their files (`fit_to_files`).
        downsample: ≥ 1: pictures are this many times smaller.
        background: sRGB, behind transparent ones.
        mask_labels: what is inside where masks hold labels, see `mask_codings`.

    Raises:
        DatasetError: any file that cannot be read; the message names it. Or masks without a meaning.
    """
    regions: dict[str, list[Path]] = defaultdict(list)
    for photograph in photographs:
        for region, path in photograph.masks.items():
            regions[region].append(path)
    codings = mask_codings(regions, mask_labels)
    return streamed(
        "reading images", lambda photograph: _view(photograph, downsample, background, codings), photographs
    )


def _view(photograph: Photograph, downsample: float, background: Color, codings: Mapping[str, Coding]) -> View:
    camera = _camera(photograph, downsample)

    def fitted(pixels: NDArray) -> torch.Tensor:
        return torch.from_numpy(_fitted(pixels, photograph.camera, camera))

    picture, opaque = read_picture(photograph.path, background, photograph.turned)
    if photograph.gains is not None:
        picture = brightened(picture, photograph.gains)
    normal = None
    if photograph.normal is not None:
        vectors = photograph.normal.read(_opaque_at(opaque, *photograph.normal.size()))
        normal = world_normals(fitted(vectors), camera, photograph.normal.frame)
    return View(
        name=photograph.view_name,
        camera=camera,
        image=fitted(picture),
        masks={region: fitted(read_mask(path, codings[region])) for region, path in photograph.masks.items()},
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
    return None if opaque is None else _at_size(opaque[..., None], width, height)[..., 0] >= OPAQUE_SHARE
