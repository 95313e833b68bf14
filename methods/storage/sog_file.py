"""SOG: PlayCanvas's archive of pictures that hold 3D Gaussians, whoever wrote it, as `GaussianParameters`' tensors.

A ZIP archive, or a folder, with meta.json of version 2 and lossless WebP pictures, a pixel a Gaussian, row by row:

| picture | value |
|---|---|
| means_l, means_u | low and high bytes of 16 bits a coordinate, between mins and maxs, of sign · log(1 + |position|) |
| scales | numbers of the codebook, logarithms |
| quats | three of w, x, y, z: (byte / 255 − ½) · √2; alpha − 252 is the place of the one left out |
| sh0 | numbers of the codebook, f_dc; alpha is opacity · 255 |
| shN_labels, shN_centroids | a number of 16 bits; 64 palette entries a row, a pixel a coefficient, of the codebook |
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from envgs_bench.regular_file import require_regular

from .splats import MOST_LOGIT

META, VERSION = "meta.json", 2
COEFFICIENTS = (0, 3, 8, 15)  # by SH degree
ENTRIES_A_ROW = 64
MOST_META_BYTES = 1 << 20
MOST_FILE_BYTES = 1 << 30
MOST_GAUSSIANS = 100_000_000
LARGEST_QUATERNION = 252  # what the alpha of a rotation counts from

Floats = NDArray[np.float64]
Open = Callable[[str, int], bytes]


def read_sog(path: Path) -> dict[str, Tensor]:
    """The set as float32 tensors.

    Args:
        path: the archive, or a folder with what such an archive holds.

    Raises:
        ValueError: it is no SOG of version 2, or a part is missing, damaged or too small; the message names the file.
    """
    try:
        if path.is_dir():
            return _read(lambda name, most: _file(path / name, most))
        require_regular(path)
        with zipfile.ZipFile(path) as archive:
            return _read(lambda name, most: _member(archive, name, most))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (zipfile.BadZipFile, Image.DecompressionBombError, KeyError, TypeError, IndexError, ValueError) as error:
        raise ValueError(f"{path}: is no readable SOG ({error}); export it again, or as a PLY") from error
    except (NotImplementedError, RuntimeError, SyntaxError) as error:  # encrypted; a picture that breaks off
        raise ValueError(f"{path}: is no readable SOG ({error}); export it again, or as a PLY") from error


def _read(opened: Open) -> dict[str, Tensor]:
    meta = json.loads(opened(META, MOST_META_BYTES))
    if not isinstance(meta, dict) or meta.get("version") != VERSION:
        found = meta.get("version") if isinstance(meta, dict) else None
        raise ValueError(f"{META} is of version {found}, expected {VERSION}")
    count = int(meta["count"])
    if not 0 <= count <= MOST_GAUSSIANS:
        raise ValueError(f"{META} promises {count} Gaussians, at most {MOST_GAUSSIANS:,} are read")

    def pixels(part: str, number: int = 0) -> NDArray[np.uint8]:
        name = str(meta[part]["files"][number])
        found = _picture(opened(name, MOST_FILE_BYTES)).reshape(-1, 4)
        if len(found) < count:
            raise ValueError(f"{name} has {len(found):,} pixels for {count:,} Gaussians")
        return found[:count]

    sh0 = pixels("sh0")
    opacity = np.clip(sh0[:, 3] / 255, 1e-12, 1 - 1e-12)
    arrays = {
        "means": _means(meta["means"], pixels("means"), pixels("means", 1)),
        "quaternions": _quaternions(pixels("quats")),
        "log_scales": _looked_up(meta["scales"], pixels("scales")[:, :3]),
        "opacity_logits": np.clip(np.log(opacity / (1 - opacity)), -MOST_LOGIT, MOST_LOGIT),
        "sh_dc": _looked_up(meta["sh0"], sh0[:, :3])[:, None],
        "sh_rest": np.zeros((count, 0, 3)),
    }
    if "shN" in meta:
        labels = pixels("shN", 1).astype(np.int64)
        palette = _picture(opened(str(meta["shN"]["files"][0]), MOST_FILE_BYTES))[..., :3]
        arrays["sh_rest"] = _rest(meta["shN"], labels[:, 0] | labels[:, 1] << 8, palette)
    if bad := [name for name, values in arrays.items() if not np.isfinite(values).all()]:
        raise ValueError(f"{', '.join(bad)} are not all finite")
    return {name: torch.from_numpy(values.astype(np.float32)) for name, values in arrays.items()}


def _means(meta: dict[str, Any], low: NDArray[np.uint8], high: NDArray[np.uint8]) -> Floats:
    share = (low[:, :3].astype(np.int64) | high[:, :3].astype(np.int64) << 8) / 65535
    least, most = (np.asarray(meta[key], np.float64).reshape(3) for key in ("mins", "maxs"))
    folded = least + share * (most - least)
    return np.sign(folded) * np.expm1(np.abs(folded))


def _quaternions(pixels: NDArray[np.uint8]) -> Floats:
    """wxyz, unit length."""
    left_out = pixels[:, 3].astype(np.int64) - LARGEST_QUATERNION
    if (left_out < 0).any():
        raise ValueError(f"a rotation's alpha is below {LARGEST_QUATERNION}")
    three = (pixels[:, :3] / 255 - 0.5) * np.sqrt(2)
    found = np.zeros((len(pixels), 4))
    for largest in range(4):
        rows = left_out == largest
        others = [component for component in range(4) if component != largest]
        found[np.ix_(rows, others)] = three[rows]
    found[np.arange(len(pixels)), left_out] = np.sqrt(np.clip(1 - np.square(three).sum(axis=1), 0, None))
    return found


def _looked_up(meta: dict[str, Any], numbers: NDArray[np.uint8]) -> Floats:
    return np.asarray(meta["codebook"], np.float64).reshape(-1)[numbers]


def _rest(meta: dict[str, Any], labels: NDArray[np.int64], palette: NDArray[np.uint8]) -> Floats:
    """[N, K, 3] of each Gaussian's entry of the palette [rows, ENTRIES_A_ROW · K, 3]."""
    coefficients = COEFFICIENTS[int(meta["bands"])]
    rows = len(palette)
    entries = palette[:, : ENTRIES_A_ROW * coefficients].reshape(rows * ENTRIES_A_ROW, coefficients, 3)
    return _looked_up(meta, entries[labels])


def _picture(content: bytes) -> NDArray[np.uint8]:
    """[H, W, 4] bytes; alpha is 255 where the file has none."""
    with Image.open(io.BytesIO(content), formats=["WEBP", "PNG"]) as image:
        return np.array(image.convert("RGBA"))


def _member(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    if archive.getinfo(name).file_size > most:
        raise ValueError(f"{name} has more than {most:,} bytes")
    return archive.read(name)


def _file(path: Path, most: int) -> bytes:
    require_regular(path, most)
    return path.read_bytes()
