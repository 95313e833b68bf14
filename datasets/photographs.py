"""Pictures as files: decoding, undistorting and shrinking them, and finding the masks and normals that go with them."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import numpy as np
import pycolmap
from numpy.typing import NDArray
from PIL import Image

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
    """The picture at a smaller size; each pixel is the mean of the area it covers, of the sRGB bytes as they are."""
    if pixels.shape[:2] == (height, width):
        return pixels
    return np.asarray(Image.fromarray(pixels).resize((width, height), Image.Resampling.BOX))


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
