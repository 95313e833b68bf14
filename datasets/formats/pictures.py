"""Pictures as files of anybody's, read as photographs and normal maps need them: every mode that has a place in
sRGB, turned where asked for, on a background where transparent. What is wrong with a file is said, nothing is guessed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, ImageOps

from envgs_bench.regular_file import require_regular

from ..errors import DatasetError

Bytes = NDArray[np.uint8]
Color = tuple[float, float, float]

LOSSY = ("JPEG", "WEBP")  # formats whose pixels may be others than those that were saved
FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF", "PPM", "GIF")  # by content; Pillow knows some that start programs
EIGHT_BITS = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "YCbCr")  # modes of 8 bits a channel or fewer
SIXTEEN_BITS = ("I;16", "I;16L", "I;16B", "I;16N", "I")
TURNED = (5, 6, 7, 8)  # EXIF orientations that exchange width and height


@dataclass(frozen=True)
class Header:
    """What a picture's file says before its pixels."""

    width: int  # pixels as they lie in the file
    height: int
    turned: bool  # its EXIF orientation asks viewers to exchange width and height
    mode: str  # Pillow's name of what a pixel holds


def read_header(path: Path) -> Header:
    """Size and turn of the picture; nothing is decoded.

    Raises:
        DatasetError: the file is no picture.
    """
    with opened_picture(path) as image:
        return Header(*image.size, image.getexif().get(ExifTags.Base.Orientation) in TURNED, image.mode)


def read_picture(path: Path, background: Color, turn: bool = False) -> tuple[Bytes, NDArray[np.bool_] | None]:
    """The picture [H, W, 3], and where it is opaque [H, W]; None for a picture without transparency.

    Transparent pixels are laid on `background`, sRGB in [0, 1], by their bytes. 16-bit gray becomes 8 bits, rounded;
    of 16-bit colors, Pillow hands over the higher byte.

    Args:
        turn: apply the file's EXIF orientation.

    Raises:
        DatasetError: the file cannot be decoded, or its pixels have no place in sRGB.
    """
    image = _decoded(path, turn)
    if image.mode not in ("LA", "PA", "RGBA") and "transparency" not in image.info:
        return np.asarray(image.convert("RGB")), None
    pixels = np.asarray(image.convert("RGBA"))
    alpha = pixels[..., 3:].astype(np.uint16)
    ground = np.array([round(255 * channel) for channel in background], dtype=np.uint16)
    laid = (pixels[..., :3] * alpha + ground * (255 - alpha) + 127) // 255
    return laid.astype(np.uint8), pixels[..., 3] == 255


def _decoded(path: Path, turn: bool) -> Image.Image:
    with opened_picture(path) as image:
        image.load()
        picture = ImageOps.exif_transpose(image) if turn else image
    if picture.mode in SIXTEEN_BITS:
        return _eight_bits(picture, path)
    if picture.mode == "CMYK":
        raise DatasetError(f"{path}: is CMYK, whose colors depend on a printer's profile; convert it to sRGB")
    if picture.mode not in EIGHT_BITS:
        raise DatasetError(f"{path}: has pixels of mode {picture.mode}, expected 8 or 16 bits a channel; convert it")
    return picture


def _eight_bits(image: Image.Image, path: Path) -> Image.Image:
    values = np.asarray(image).astype(np.int64)
    if values.min() < 0 or values.max() > 65535:
        raise DatasetError(
            f"{path}: has values from {values.min()} to {values.max()}, expected 8 or 16 bits; convert it"
        )
    return Image.fromarray(((values + 128) // 257).astype(np.uint8))


@contextmanager
def opened_picture(path: Path) -> Iterator[Image.Image]:
    """The file as Pillow opens it, not decoded yet; raises DatasetError for what is none, within the block too."""
    try:
        require_regular(path)
        with Image.open(path, formats=FORMATS) as image:
            yield image
    except (MemoryError, DatasetError):
        raise
    except Exception as error:  # Pillow raises whatever foreign bytes lead it to
        raise DatasetError(f"{path}: cannot be decoded ({error}); replace it by an intact image") from error
