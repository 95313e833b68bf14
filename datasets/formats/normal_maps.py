"""Normal maps as files, and the encodings the field knows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import DatasetError
from ..settings import Frame
from .arrays import open_array
from .pictures import read_header, read_picture
from .srgb import to_linear

if TYPE_CHECKING:  # which files a capture is made from is found without torch
    import torch

    from envgs_bench.core import Camera

Floats = NDArray[np.float32]

MIN_LENGTH, MAX_LENGTH = 0.5, 1.5  # a decoded vector outside is no normal: a gray, black or white pixel
ROUNDING = 1e-5  # lengths this close to 1 are 1: what is normalized already keeps its bits
UNIT_TOLERANCE = 0.03  # deviation of a length from 1
MIN_SHARE = 0.9  # share of a picture's opaque pixels that an encoding must fit


@dataclass(frozen=True)
class NormalMap:
    """A file of normals: `.npy` floats [H, W, 3], or a picture.

    Attributes:
        rendered: it comes from a blender scene, whose encoding is found from the pixels.
    """

    path: Path
    frame: Frame = "world"
    rendered: bool = False

    def size(self) -> tuple[int, int]:
        """Width and height, without reading it all."""
        if self.path.suffix == ".npy":
            height, width = _array(self.path).shape[:2]
            return width, height
        header = read_header(self.path)
        return header.width, header.height

    def read(self, opaque: NDArray[np.bool_] | None) -> Floats:
        """The vectors in the file's own frame, [H, W, 3]; 0 where unknown.

        A picture holds them as rgb = 255·(n/2 + 1/2); a blender scene's may also hold max(n, 0), encoded to sRGB, which
        says the normal only where no component is negative: where the length is one.

        Args:
            opaque: where the image shows something, [H, W] of the map's size; None for everywhere.

        Raises:
            DatasetError: the file cannot be read, or holds no normals.
        """
        if self.path.suffix == ".npy":
            with np.errstate(over="ignore"):
                vectors = _array(self.path).astype(np.float32)
            return _known(np.nan_to_num(vectors, posinf=0, neginf=0), opaque)
        rgb: Floats = read_picture(self.path, (0.5, 0.5, 0.5))[0].astype(np.float32) / np.float32(255)
        signed = 2 * rgb - 1
        if not self.rendered or _share(_is_unit(signed), opaque) >= MIN_SHARE:
            return _known(signed, opaque)
        clamped = to_linear(rgb)
        if _share(np.linalg.norm(clamped, axis=-1) < 1 + UNIT_TOLERANCE, opaque) < MIN_SHARE:
            raise DatasetError(
                f"{self.path}: holds neither rgb = 255·(n/2 + 1/2) nor sRGB of max(n, 0); "
                "remove the file, or store the normals as float [H, W, 3] in a .npy of the same name"
            )
        return np.where(_is_unit(clamped)[..., None], _known(clamped, opaque), 0)


def world_normals(normals: torch.Tensor, camera: Camera, frame: Frame) -> torch.Tensor:
    """World-frame unit normals that face the camera, [H, W, 3], of vectors in `frame`; 0 for those shorter than ½.

    Estimators and meshes leave normals that face away; seen from the front, a surface's normal faces the viewer.
    """
    import torch

    if frame == "opengl":
        normals = normals * torch.tensor([1.0, -1.0, -1.0])
    if frame != "world":
        normals = normals @ camera.world_to_camera[:3, :3]
    length = normals.norm(dim=-1, keepdim=True)
    unit = torch.where((length - 1).abs() < ROUNDING, normals, normals / length.clamp(min=MIN_LENGTH))
    away = (unit * camera.rays()[1]).sum(-1, keepdim=True) > 0
    return torch.where(length < MIN_LENGTH, torch.zeros_like(unit), torch.where(away, -unit, unit))


def _array(path: Path) -> NDArray:
    array = open_array(path)
    if array.ndim != 3 or array.shape[2] != 3 or array.dtype.kind != "f":
        raise DatasetError(f"{path}: holds {array.dtype} {list(array.shape)}, expected floats [H, W, 3]")
    return array


def _known(normals: Floats, opaque: NDArray[np.bool_] | None) -> Floats:
    length = np.linalg.norm(normals, axis=-1)
    known = (length > MIN_LENGTH) & (length < MAX_LENGTH)
    if opaque is not None:
        known &= opaque
    return np.where(known[..., None], normals, np.float32(0))


def _is_unit(normals: Floats) -> NDArray[np.bool_]:
    return np.abs(np.linalg.norm(normals, axis=-1) - 1) < UNIT_TOLERANCE


def _share(which: NDArray[np.bool_], opaque: NDArray[np.bool_] | None) -> float:
    """The share of these pixels [H, W] among those that show something; 1 where none shows anything."""
    chosen = which if opaque is None else which[opaque]
    return float(chosen.mean()) if chosen.size else 1.0
