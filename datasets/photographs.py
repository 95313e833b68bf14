"""Pictures as files: decoding, undistorting and shrinking them, and finding the masks and normals that go with them."""

from __future__ import annotations

from functools import cache
from pathlib import Path, PurePosixPath

import numpy as np
import pycolmap
from numpy.typing import NDArray
from PIL import Image
from scipy import sparse

from .settings import DatasetError

Bytes = NDArray[np.uint8]

PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "CMYK", "YCbCr")  # of 8 bits a channel or fewer


def read_picture(path: Path, background: tuple[float, float, float]) -> Bytes:
    """The picture [H, W, 3], as its pixels lie in the file (EXIF turns are not applied, nor does COLMAP apply them).

    Transparent ones are laid on `background`, sRGB in [0, 1].

    Raises:
        DatasetError: the file cannot be decoded, or holds more than 8 bits a channel.
    """
    image = _decoded(path)
    if image.mode in ("LA", "PA", "RGBA") or "transparency" in image.info:
        ground = tuple(round(255 * channel) for channel in background)
        image = Image.alpha_composite(Image.new("RGBA", image.size, (*ground, 255)), image.convert("RGBA"))
    return np.asarray(image.convert("RGB"))


def read_mask(path: Path) -> Bytes:
    """The mask [H, W]: 255 inside, 0 outside. Inside is the brighter half of the grey scale, or 1 among 0 and 1.

    Raises:
        DatasetError: as `read_picture`.
    """
    values = np.asarray(_decoded(path).convert("L"))
    return np.where(values >= (128 if values.max() > 1 else 1), 255, 0).astype(np.uint8)


def _decoded(path: Path) -> Image.Image:
    try:
        with Image.open(path) as image:
            image.load()
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise DatasetError(f"{path}: cannot be decoded ({error}); replace it by an intact image") from error
    if image.mode not in MODES:
        raise DatasetError(f"{path}: has pixels of mode {image.mode}, expected 8 bits a channel; convert it")
    return image


def undistorted_camera(camera: pycolmap.Camera) -> pycolmap.Camera:
    """The pinhole camera that sees what `camera` sees, without borders where there is no picture."""
    if camera.model.name in PINHOLES:
        return camera
    return pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), camera)


def undistort(pixels: Bytes, camera: pycolmap.Camera) -> Bytes:
    """What `undistorted_camera(camera)` sees of the picture [H, W, 3] or [H, W], bilinear."""
    if camera.model.name in PINHOLES:
        return pixels
    bitmap = pycolmap.Bitmap.from_array(np.ascontiguousarray(pixels))
    result, _ = pycolmap.undistort_image(pycolmap.UndistortCameraOptions(), bitmap, camera)
    return result.to_array().reshape(result.height, result.width, *pixels.shape[2:])


def shrink(pixels: Bytes, width: int, height: int) -> Bytes:
    """The picture at a smaller size; each pixel is the mean of the area it covers, of the sRGB bytes as they are.

    Exact for sizes that do not divide, where Pillow's box filter takes whole pixels and so moves the picture by up to
    half of one against its intrinsics.
    """
    if pixels.shape[:2] == (height, width):
        return pixels
    flat = pixels.reshape(*pixels.shape[:2], -1).astype(np.float32)
    rows = _overlaps(flat.shape[0], height) @ flat.reshape(flat.shape[0], -1)
    sideways = rows.reshape(height, flat.shape[1], -1).swapaxes(0, 1).reshape(flat.shape[1], -1)
    columns = (_overlaps(flat.shape[1], width) @ sideways).reshape(width, height, -1).swapaxes(0, 1)
    return np.round(columns).astype(np.uint8).reshape(height, width, *pixels.shape[2:])


@cache
def _overlaps(length: int, bins: int) -> sparse.csr_array:
    """[bins, length]: the share of each of a line's `length` pixels in the means over its `bins` equal parts."""
    edges, pieces = np.linspace(0, length, bins + 1), np.arange(length)
    common = np.minimum(edges[1:, None], pieces + 1) - np.maximum(edges[:-1, None], pieces)
    return sparse.csr_array(np.maximum(common, 0) * (bins / length), dtype=np.float32)


class Siblings:
    """Files of a folder, found by an image's name: the same path below the folder, with any extension."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._paths = {
            path.relative_to(folder).with_suffix("").as_posix(): path
            for path in sorted(folder.rglob("*"))
            if path.is_file() and not path.name.startswith(".")
        }

    def find(self, image_name: str) -> Path | None:
        """The file for image `a/b.jpg`: `a/b.<any>` or, as COLMAP names masks, `a/b.jpg.<any>`; None without one."""
        stem = PurePosixPath(image_name).with_suffix("").as_posix()
        return self._paths.get(stem) or self._paths.get(image_name)
