"""SPZ: Niantic's file of 3D Gaussians, whoever wrote it, read into `GaussianParameters`' tensors.

A gzip stream of 16 bytes and then of fields, each of all Gaussians together, little-endian:

| field | bytes a Gaussian | value |
|---|---|---|
| position | 9 (6 in version 1) | three signed numbers of 24 bits / 2^fractional bits (three float16) |
| alpha | 1 | opacity · 255 |
| color | 3 | (f_dc · 0.15 + 0.5) · 255 |
| scale | 3 | (logarithm + 10) · 16 |
| rotation | 4 (3 before version 3) | the three smallest of the quaternion's components (x, y, z / 127.5 − 1) |
| SH | 3 · coefficients | 128 + 128 · value, the channels of a coefficient side by side |

Axes are right, up, back where a PLY's are right, down, forward: what is read is turned by half a turn about x.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envgs_bench.regular_file import require_regular

from .splats import MOST_LOGIT, half_turn

MAGIC, VERSIONS = b"NGSP", (1, 2, 3)
HEADER = struct.Struct("<4sIIBBBB")
REST = (0, 3, 8, 15)  # SH coefficients beyond the constant one, by degree
COLOR_SCALE = 0.15
MOST_GAUSSIANS = 100_000_000
HALF_ROOT = 1 / np.sqrt(2)

Bytes = NDArray[np.uint8]


def read_spz(path: Path) -> dict[str, Tensor]:
    """The set as float32 tensors, in a PLY's axes.

    Raises:
        ValueError: no SPZ, one of a version that is not known here, or one that ends early; the message names it.
    """
    content, header = _opened(path)
    version, count, degree, fraction = header
    sizes = {
        **{"means": 9 if version > 1 else 6, "alphas": 1, "colors": 3, "scales": 3},
        **{"rotations": 4 if version > 2 else 3, "sh": 3 * REST[degree]},
    }
    expected = HEADER.size + count * sum(sizes.values())
    if len(content) != expected:
        raise ValueError(f"{path}: holds {len(content):,} bytes once unpacked, {count:,} Gaussians take {expected:,}")
    fields: dict[str, Bytes] = {}
    at = HEADER.size
    for name, size in sizes.items():
        fields[name] = np.frombuffer(content, np.uint8, count * size, at).reshape(count, size)
        at += count * size
    opacity = np.clip(fields["alphas"][:, 0] / 255, 1e-12, 1 - 1e-12)
    arrays = {
        "means": _fixed(fields["means"], fraction) if version > 1 else _halves(fields["means"]),
        "quaternions": _smallest_three(fields["rotations"]) if version > 2 else _three(fields["rotations"]),
        "log_scales": fields["scales"] / 16 - 10,
        "opacity_logits": np.clip(np.log(opacity / (1 - opacity)), -MOST_LOGIT, MOST_LOGIT),
        "sh_dc": ((fields["colors"] / 255 - 0.5) / COLOR_SCALE)[:, None],
        "sh_rest": ((fields["sh"].astype(np.float64) - 128) / 128).reshape(count, REST[degree], 3),
    }
    return half_turn({name: torch.from_numpy(values.astype(np.float32)) for name, values in arrays.items()})


def _opened(path: Path) -> tuple[bytes, tuple[int, int, int, int]]:
    """The unpacked file, no more of it than its header promises; version, count, SH degree and fractional bits."""
    try:
        require_regular(path)
        packed = path.read_bytes()
        stream = zlib.decompressobj(wbits=31)
        head = stream.decompress(packed, HEADER.size)
        if len(head) < HEADER.size:
            raise ValueError("it ends within its header")
        magic, version, count, degree, fraction, *_ = HEADER.unpack(head)
        if magic != MAGIC:
            raise ValueError(f"it begins with {magic!r}, expected {MAGIC!r}")
        if version not in VERSIONS or degree >= len(REST) or count > MOST_GAUSSIANS:
            raise ValueError(
                f"version {version}, SH degree {degree}, {count:,} Gaussians; "
                f"versions {VERSIONS[0]} to {VERSIONS[-1]}, degrees to {len(REST) - 1} and {MOST_GAUSSIANS:,} are read"
            )
        most = count * (9 + 1 + 3 + 3 + 4 + 3 * REST[degree]) + 1
        return head + stream.decompress(stream.unconsumed_tail, most), (version, count, degree, fraction)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (zlib.error, ValueError) as error:
        raise ValueError(f"{path}: is no readable SPZ ({error}); export it again, or as a PLY") from error


def _fixed(rows: Bytes, fraction: int) -> NDArray[np.float64]:
    parts = rows.reshape(len(rows), 3, 3).astype(np.int64)
    values = parts[..., 0] | parts[..., 1] << 8 | parts[..., 2] << 16
    return np.where(values >= 1 << 23, values - (1 << 24), values) / 2.0**fraction


def _halves(rows: Bytes) -> NDArray[np.float64]:
    return np.ascontiguousarray(rows).view("<f2").astype(np.float64)


def _three(rows: Bytes) -> NDArray[np.float64]:
    """wxyz of (x, y, z), w being what is left of the unit length."""
    xyz = rows / 127.5 - 1
    w = np.sqrt(np.clip(1 - np.square(xyz).sum(axis=1), 0, None))
    return np.column_stack([w, xyz])


def _smallest_three(rows: Bytes) -> NDArray[np.float64]:
    """wxyz of 2 bits that say which of xyzw is left out, and 10 bits, sign and size, of each other."""
    packed = np.ascontiguousarray(rows).view("<u4")[:, 0].astype(np.int64)
    left_out = packed >> 30
    xyzw = np.zeros((len(rows), 4))
    for component in (3, 2, 1, 0):
        there = left_out != component
        size = HALF_ROOT * (packed & 511) / 511
        xyzw[there, component] = np.where(packed >> 9 & 1, -size, size)[there]
        packed = np.where(there, packed >> 10, packed)
    xyzw[np.arange(len(rows)), left_out] = np.sqrt(np.clip(1 - np.square(xyzw).sum(axis=1), 0, None))
    return xyzw[:, [3, 0, 1, 2]]
