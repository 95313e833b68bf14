"""A set of Gaussians as small whole numbers: the fields of `GaussianParameters`, quantized, and back.

Rows are sorted along a Morton curve, so that neighbors in space are neighbors in the file. Then, by field:

| field | is stored as |
|---|---|
| means | differences of successive places on the curve, of a grid with one step for all axes |
| log_scales, sh_dc, sh_rest, and SH of a material | numbers of steps |
| quaternions | the number of the largest component, which is made positive, and the other three as numbers of steps |
| opacity_logits, beta_logits, logits of a material | the sigmoid as one of 256 levels |
| any other | float32, as it is |

Whole numbers become planes of bytes (`planes.py`). Steps and origins stand in the header, so that a file is read
without knowing the constants here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..gaussians.ordering import codes_on, grid_of, grid_points
from .planes import planes_of, planes_of_steps, values_of, whole_numbers

# The sizes of the steps, chosen by what they cost and lose one by one (docs/reference/layouts.md).
POSITION_STEP = 0.1  # of the median over the primitives of their smallest scale
STEPS = {"log_scales": 1 / 20, "quaternions": 1 / 256, "_dc": 1 / 16, "_rest": 1 / 16}  # by the ends of fields' names
LARGEST = 88.0  # logarithm of a scale: float32 knows none that is larger
LOGITS = "_logits"
LEVELS = 255  # the highest level of a sigmoid; the lowest is 0
END = 0.25  # levels: what the lowest and the highest are read as, from 0 and from 255, since their logits are infinite

Arrays = dict[str, NDArray[Any]]
Header = dict[str, Any]


def quantize(tensors: Mapping[str, Tensor]) -> tuple[Header, Arrays]:
    """The header, plain JSON, and the arrays, by name, of `GaussianParameters`' tensors.

    Raises:
        ValueError: a value is not finite, or too large; the message names the field.
    """
    rows = {name: value.detach().cpu().float().numpy() for name, value in tensors.items()}
    for name, values in rows.items():
        if not np.isfinite(values).all():
            raise ValueError(f"{name} are not all finite: such a model cannot be stored")
    means, log_scales = rows.pop("means").astype(np.float64), rows["log_scales"]
    median = np.median(log_scales.astype(np.float64).min(1)) if len(means) else 0.0
    origin, step = grid = grid_of(means, POSITION_STEP * float(np.exp(min(median, LARGEST))))
    codes = codes_on(grid, means)
    order = np.argsort(codes, kind="stable")
    arrays: Arrays = {}
    arrays["means"], least = planes_of(np.diff(codes[order], prepend=np.int64(0)))
    fields: Header = {"means": {"origin": origin.tolist(), "step": step, "least": least}}
    for name, values in rows.items():
        fields[name] = {"shape": list(values.shape[1:])}
        values = values[order]
        if name == "quaternions":
            arrays["quaternions_largest"], values = _without_largest(values)
        if name.endswith(LOGITS):
            levels = np.rint(LEVELS / (1 + np.exp(-values.astype(np.float64))))
            arrays[name] = levels.astype(np.uint8)
            fields[name]["levels"] = LEVELS
        elif name.endswith(tuple(STEPS)):
            arrays[name], steps = planes_of_steps(values, _step(name, values), name)
            fields[name] |= steps
        else:
            arrays[name] = values.astype("<f4")
    return {"count": len(means), "fields": fields}, arrays


def dequantize(header: Header, arrays: Mapping[str, NDArray[Any]]) -> dict[str, Tensor]:
    """`GaussianParameters`' tensors, float32, of what `quantize` returned, in the order of the file's rows.

    Raises:
        KeyError, TypeError, ValueError: header and arrays do not belong together.
    """
    count = header["count"]
    tensors: dict[str, Tensor] = {}
    for name, field in header["fields"].items():
        shape = (count, *field.get("shape", [3]))
        if name == "means":
            codes = np.cumsum(whole_numbers(arrays[name], field["least"], (count,)))
            values = np.array(field["origin"], np.float64) + grid_points(codes) * field["step"]
        elif name == "quaternions":
            values = _with_largest(arrays["quaternions_largest"], values_of(arrays[name], field, (count, 3)))
        elif "levels" in field:
            share = arrays[name].astype(np.float64).clip(END, field["levels"] - END) / field["levels"]
            values = np.log(share / (1 - share))
        elif "step" in field:
            values = values_of(arrays[name], field, shape)
        else:
            values = arrays[name]
        tensors[name] = torch.from_numpy(np.ascontiguousarray(values.reshape(shape), np.float32))
    return tensors


def _step(name: str, values: NDArray[Any]) -> float:
    """The field's own; at most its values' root mean square, where a short training has left them small."""
    square = float(np.square(values, dtype=np.float64).mean()) if values.size else 0.0
    usual = next(step for end, step in STEPS.items() if name.endswith(end))
    return min(usual, square**0.5) if name.endswith("_rest") and square else usual


def _without_largest(quaternions: NDArray[np.float32]) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """The number [N] of the largest component of each of [N, 4], and the three that follow it, of the unit quaternion.

    The largest is made positive, q and −q being the same rotation. A quaternion of four zeros, which is no rotation,
    becomes the one that turns nothing.
    """
    unit = quaternions.astype(np.float64)
    length = np.linalg.norm(unit, axis=1, keepdims=True)
    unit = np.where(length > 0, unit / np.where(length > 0, length, 1), [1.0, 0, 0, 0])
    largest = np.abs(unit).argmax(1)
    signs = np.sign(np.take_along_axis(unit, largest[:, None], 1))
    following = (largest[:, None] + np.arange(1, 4)) % 4
    return largest.astype(np.uint8), np.take_along_axis(unit, following, 1) * signs


def _with_largest(largest: NDArray[np.uint8], three: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternions [N, 4], of what `_without_largest` returned."""
    if len(largest) and largest.max() > 3:
        raise ValueError(f"a quaternion's largest component is number {largest.max()}, expected 0 to 3")
    place = largest.astype(np.int64)[:, None]
    quaternions = np.empty((len(three), 4))
    np.put_along_axis(quaternions, (place + np.arange(1, 4)) % 4, three, 1)
    rest = np.sqrt((1 - np.square(three).sum(1, keepdims=True)).clip(0, 1))
    np.put_along_axis(quaternions, place, rest, 1)
    return quaternions
