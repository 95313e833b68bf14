"""Layouts of viewers and other programs: SPZ, SOG and PlayCanvas's compressed PLY, lossy, by the library gaussforge.

They hold 3D Gaussians: position, three scales, rotation, opacity and SH up to degree 3. A surfel goes in as a Gaussian
that is flat along its normal, its third scale e^FLAT, and comes back without it. There is no place for β.

A PLY's axes are taken for right, down, forward, and SPZ's are right, up, back: what goes into SPZ is turned by half a
turn about x, which viewers turn back, and which gaussforge leaves to its callers.

Only what was written here is read back: gaussforge 0.6.0 ends the process on many damaged SOG files.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from torch import Tensor
from torch.nn import functional

from envgs_bench.ply_file import read_elements

from ..gaussians.ordering import along_curve
from .ply import vertex_tensors

SPLAT_LAYOUTS = {"spz": "spz", "sog": "sog", "compressed-ply": "compressed.ply"}  # layout -> gaussforge's name of it
# Signs under (x, y, z) -> (x, −y, −z), of the SH basis functions of degree 1, 2 and 3 in 3DGS's order.
HALF_TURN_SH = (-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1)
FLAT = -10.0  # logarithm of the flat scale, world units: the least that SPZ holds
MOST_LOGIT = 17.0  # of an opacity: those that were rounded to 0 or to 1 come back as infinite logits


def encode_splats(layout: str, tensors: Mapping[str, Tensor]) -> bytes:
    """The file of `GaussianParameters`' tensors in one of SPLAT_LAYOUTS, without β, in Morton order.

    Raises:
        ValueError: the library is not installed, or refuses the set: none of the layouts holds an empty one.
    """
    turned = half_turn(tensors) if layout == "spz" else tensors
    rows = {name: value.detach().cpu().float().numpy() for name, value in turned.items()}
    order = along_curve(rows["means"])
    count, axes = rows["log_scales"].shape
    scales = rows["log_scales"] if axes == 3 else np.column_stack([rows["log_scales"], np.full(count, FLAT)])
    quaternions = functional.normalize(turned["quaternions"].detach().cpu().float(), dim=1).numpy()
    rest = rows["sh_rest"]
    if layout == "compressed-ply":
        # gaussforge 0.6.0 writes coefficients in the order that it is given them in, and reads, as other programs do,
        # all of red first.
        rest = rest.swapaxes(1, 2)
    fields = {
        **{"positions": rows["means"], "scales": scales, "rotations": quaternions},
        **{"alphas": rows["opacity_logits"], "colors": rows["sh_dc"], "sh": rest},
    }
    degree = round((rest.size // max(count, 1) // 3 + 1) ** 0.5) - 1
    cloud: dict[str, Any] = {"numPoints": count, "meta": {"shDegree": degree, "sourceFormat": "ply"}}
    cloud |= {name: np.ascontiguousarray(values[order], np.float32).tobytes() for name, values in fields.items()}
    return _data(layout, require_library().write(cloud, SPLAT_LAYOUTS[layout]))


def decode_splats(layout: str, content: bytes, axes: int) -> dict[str, Tensor]:
    """The tensors, without β, of what `encode_splats` wrote for a set with this many scales.

    Raises:
        ValueError: the library is not installed or cannot read the file.
    """
    ply = _data(layout, require_library().convert(content, SPLAT_LAYOUTS[layout], "ply"))
    with TemporaryDirectory() as folder:  # plyfile reads a file at once, and a stream row by row
        path = Path(folder) / "set.ply"
        path.write_bytes(ply)
        vertices = read_elements(path)["vertex"]
        vertices.data["opacity"] = vertices.data["opacity"].clip(-MOST_LOGIT, MOST_LOGIT)
        tensors = vertex_tensors(vertices, path)
    tensors = half_turn(tensors) if layout == "spz" else tensors
    return tensors | {"log_scales": tensors["log_scales"][:, :axes].contiguous()}


def half_turn(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The set turned about the x axis by 180°, which twice is the set itself."""
    rest = tensors["sh_rest"]
    return dict(tensors) | {
        "means": tensors["means"] * rest.new_tensor([1, -1, -1]),
        "quaternions": tensors["quaternions"][:, [1, 0, 3, 2]] * rest.new_tensor([-1, 1, -1, 1]),
        "sh_rest": rest * rest.new_tensor(HALF_TURN_SH[: rest.shape[1]])[:, None],
    }


def require_library() -> Any:
    """What reads and writes these layouts. Raises ValueError, with how to install it, where it is not installed."""
    try:
        import gaussforge
    except ImportError as error:
        names = ", ".join(SPLAT_LAYOUTS)
        raise ValueError(f"{names} need the library gaussforge: pip install 'envgs-bench[viewers]'") from error
    return gaussforge.GaussForge()


def _data(layout: str, answer: Mapping[str, Any]) -> bytes:
    if "error" in answer:
        raise ValueError(f"gaussforge cannot convert the set to or from {layout}: {answer['error']}")
    return answer["data"]
