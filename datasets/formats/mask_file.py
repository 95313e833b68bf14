"""Mask files as they are stored: the value of every pixel, in whichever form a program wrote it, before any meaning."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..errors import DatasetError
from .arrays import open_array
from .pictures import LOSSY, opened_picture, read_header

ARRAY = ".npy"
FULL = {"I;16": 65535, "I;16L": 65535, "I;16B": 65535, "I;16N": 65535, "I": 65535, "F": 1}  # white, where it is not 255


@dataclass(frozen=True)
class MaskFile:
    """What a file holds.

    Attributes:
        values: [H, W] gray values, indices of `palette`, or colors as 0xRRGGBB where `colored`.
        full: the gray value that is white; 0 where nothing is, as in an array of whole numbers.
        palette: by index the color 0xRRGGBB; None where values are none.
        opaque: [H, W] the share in [0, 1] that is not transparent; None of a file without transparency.
        lossy: values are not to be trusted to the last, as a JPEG's.
    """

    values: NDArray
    full: int
    palette: dict[int, int] | None = None
    colored: bool = False
    opaque: NDArray[np.float32] | None = None
    lossy: bool = False


def mask_size(path: Path) -> tuple[int, int]:
    """Width and height, without reading it all."""
    if path.suffix == ARRAY:
        height, width = _plane(path).shape
        return width, height
    header = read_header(path)
    return header.width, header.height


def read_mask_file(path: Path) -> MaskFile:
    """The file's pixels.

    Raises:
        DatasetError: it cannot be decoded, or no mask has such pixels.
    """
    if path.suffix == ARRAY:
        return _of_array(path)
    with opened_picture(path) as image:
        image.load()
        lossy = image.format in LOSSY
        if image.mode == "L" and "transparency" not in image.info:
            return MaskFile(np.asarray(image).astype(np.int64), 255, lossy=lossy)
        if image.mode in ("1", *FULL) and "transparency" not in image.info:
            return _of_gray(path, np.asarray(image), FULL.get(image.mode, 255))
        if image.mode == "P" and "transparency" not in image.info:
            return MaskFile(np.asarray(image).astype(np.int64), 255, _palette(image), lossy=lossy)
        if image.mode not in ("L", "LA", "P", "PA", "RGB", "RGBA", "YCbCr"):
            raise DatasetError(f"{path}: has pixels of mode {image.mode}, which no mask has; save it as gray PNG")
        return _of_colors(image, lossy)


def _of_array(path: Path) -> MaskFile:
    values = np.array(_plane(path))
    if values.dtype == np.bool_:
        return MaskFile(np.where(values, 255, 0), 255)
    return _of_gray(path, values, 1 if values.dtype.kind == "f" else 0)


def _plane(path: Path) -> NDArray:
    array = open_array(path)
    plane = array.reshape(array.shape[-2:] if array.ndim == 3 and array.shape[0] == 1 else array.shape[:2])
    if plane.ndim != 2 or plane.dtype.kind not in "buif":
        raise DatasetError(f"{path}: holds {array.dtype} {list(array.shape)}, expected numbers [H, W]")
    return plane


def _of_gray(path: Path, values: NDArray, full: int) -> MaskFile:
    if values.dtype == np.bool_:
        return MaskFile(np.where(values, 255, 0), 255)
    if values.dtype.kind != "f":
        whole = values.astype(np.int64)
        # Black and white are the same masks at any depth.
        return MaskFile(np.where(whole, 255, 0), 255) if full and _holds_only(whole, 0, full) else MaskFile(whole, full)
    if not np.isfinite(values).all():
        raise DatasetError(f"{path}: has values that are no numbers; save it as gray PNG")
    if (values == np.round(values)).all():
        return MaskFile(values.astype(np.int64), 0)
    return MaskFile(values.astype(np.float64), full)


def _of_colors(image: Image.Image, lossy: bool) -> MaskFile:
    pixels = np.asarray(image.convert("RGBA"))
    red, green, blue, alpha = np.moveaxis(pixels, -1, 0)
    transparent = image.mode in ("LA", "PA", "RGBA") or "transparency" in image.info
    opaque = alpha.astype(np.float32) / 255 if transparent else None
    shown = np.ones(alpha.shape, np.bool_) if opaque is None else alpha > 0
    if lossy or ((red == green) & (green == blue) | ~shown).all():
        gray = np.asarray(image.convert("RGB").convert("L")) if lossy else red
        return MaskFile(gray.astype(np.int64), 255, opaque=opaque, lossy=lossy)
    colors = (red.astype(np.int64) << 16) + (green.astype(np.int64) << 8) + blue
    return MaskFile(colors, 255, colored=True, opaque=opaque)


def _palette(image: Image.Image) -> dict[int, int]:
    palette = image.palette
    entries = np.frombuffer(b"" if palette is None or palette.mode != "RGB" else palette.tobytes(), np.uint8)
    if not entries.size:
        entries = np.asarray(image.getpalette("RGB") or [], np.uint8)
    colors = entries[: len(entries) // 3 * 3].reshape(-1, 3).astype(int)
    return {index: (int(r) << 16) + (int(g) << 8) + int(b) for index, (r, g, b) in enumerate(colors)}


def _holds_only(values: NDArray[np.int64], low: int, high: int) -> bool:
    return bool(((values == low) | (values == high)).all())
