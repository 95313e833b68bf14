"""compact: a whole model in one small file, lossy. The sets are quantized (`quantized_set.py`), and then packed.

The file is a zip, each member compressed by LZMA, that `numpy.load` opens: `header.json`, and an array a member. The
header holds what is no array and says what the arrays are:

    {"layout": 2, "method": "EnvGS", "state": {"sets": {"base": {"set": {"count": 57600, "fields": …}}, …},
     "radius": 4.1, "near": 0.2, "background": {"tensor": "float32", "shape": [3]}}}

Arrays are named after their place in it, `sets.base.sh_dc.npy`. One of more than PART bytes is a member a part, so that
parts are compressed at once: `sets.base.sh_rest.0.npy`, `….1.npy`, …, which are flat and follow each other. Layout 1,
which is read too, had one member for every array. Of the tensors outside of sets, those in STEPS are quantized, the
others are kept as they are. The same model makes the same bytes.
"""

from __future__ import annotations

import io
import json
import math
import os
import zipfile
from collections.abc import Iterator, Mapping
from itertools import count, takewhile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from envgs_bench.core.threads import workers
from envgs_bench.regular_file import require_regular

from .lzma_zip import zip_of
from .planes import planes_of_steps, values_of
from .quantized_set import Arrays, dequantize, quantize

FILE_NAME = "model.npz"
HEADER = "header.json"
LAYOUT = 2
READ = (1, LAYOUT)
PART = 1 << 19  # bytes: smaller parts compress less, larger ones keep fewer processors busy
STEPS = {  # of tensors outside of sets
    "texels": 1 / 16,  # logits of a cube map's colors, which are then off by 1/128 at most
    "map_colors": 1 / 128,  # of a cube map that learns them
    "planes": 1 / 32,  # of an illumination field; trained values are some tenths
    "lines": 1 / 32,
}
SET, TENSOR = "set", "tensor"  # the keys of a header's nodes that stand for arrays

MOST_HEADER_BYTES = 1 << 20
MOST_EXPANSION = 100  # numbers that a file may promise for each of its bytes; a trained model has 3 to 5
SMALL = 100_000  # numbers that any file may promise

State = dict[str, Any]  # tensors, numbers, strings, and dictionaries of them; "sets": `GaussianParameters`' tensors


def encode(method: str, state: Mapping[str, Any]) -> bytes:
    """The file that holds `state`, what `GaussianMethod.state` returned, of the class `method`.

    Raises:
        ValueError: a value is not finite or too large to be stored.
    """
    arrays: Arrays = {}
    tree = {name: _reduced(name, value, arrays) for name, value in state.items()}
    header = {"layout": LAYOUT, "method": method, "state": tree}
    members = {HEADER: json.dumps(header).encode()}
    for name, values in arrays.items():
        members |= {f"{part}.npy": _npy(content) for part, content in _parts(name, np.ascontiguousarray(values))}
    return zip_of(members, workers())


def write_compact(folder: Path, method: str, state: Mapping[str, Any]) -> Path:
    """Write folder/model.npz, atomically, and return its path. Raises as `encode`."""
    content = encode(method, state)
    folder.mkdir(parents=True, exist_ok=True)
    path, partial = folder / FILE_NAME, folder / f"{FILE_NAME}.partial"
    partial.write_bytes(content)
    os.replace(partial, path)
    return path


def read_compact(folder: Path, method: str) -> State:
    """The state that `write_compact` wrote, its sets as float32, tensors on the CPU.

    Raises:
        ValueError: folder/model.npz is no such file, damaged, promises more than it can hold, or is another method's;
            the message names it.
    """
    path = folder / FILE_NAME
    try:
        size = require_regular(path)
        with zipfile.ZipFile(path) as archive:
            header = json.loads(_content(archive, HEADER, MOST_HEADER_BYTES))
            written_by, layout = header["method"], header["layout"]
            if layout not in READ:
                raise ValueError(f"its layout is {layout}, this version reads {' and '.join(map(str, READ))}")
            _check_promises(header["state"], archive, size)
            state = {name: _restored(name, node, archive) for name, node in header["state"].items()}
    except Exception as error:  # zipfile, LZMA and NumPy raise whatever foreign bytes lead them to
        reason = f"{type(error).__name__}: {error}"
        raise ValueError(f"{path} is not a readable model ({reason}); write it again") from error
    if written_by != method:
        raise ValueError(f"{path} holds a model of {written_by}, expected one of {method}")
    return state


def _reduced(place: str, value: Any, arrays: Arrays) -> Any:
    """`value` as JSON, its tensors put into `arrays` under names that begin with `place`."""
    if isinstance(value, Tensor):
        values = value.detach().cpu().numpy()
        if not np.isfinite(values).all():
            raise ValueError(f"{place} are not all finite: such a model cannot be stored")
        node = {TENSOR: str(values.dtype), "shape": list(values.shape)}
        if place in STEPS:
            arrays[place], steps = planes_of_steps(values, STEPS[place], place)
            return node | steps | {"planes": len(arrays[place])}
        arrays[place] = values
        return node
    if isinstance(value, Mapping):
        if "means" in value and "log_scales" in value:
            header, own = quantize(value)
            arrays |= {f"{place}.{name}": values for name, values in own.items()}
            return {SET: header, "arrays": {name: [str(v.dtype), *v.shape] for name, v in own.items()}}
        return {key: _reduced(f"{place}.{key}", part, arrays) for key, part in value.items()}
    return value


def _restored(place: str, node: Any, archive: zipfile.ZipFile) -> Any:
    """What `_reduced` made `node` of."""
    if not isinstance(node, dict):
        return node
    if SET in node:
        described = node["arrays"].items()
        arrays = {name: _array(archive, f"{place}.{name}", kind, shape) for name, (kind, *shape) in described}
        return dequantize(node[SET], arrays)
    if TENSOR in node:
        shape = node["shape"]
        if "step" not in node:
            return torch.from_numpy(_array(archive, place, node[TENSOR], shape))
        planes = _array(archive, place, "uint8", [node["planes"], *shape])
        return torch.from_numpy(values_of(planes, node, tuple(shape)).astype(np.float32))
    return {key: _restored(f"{place}.{key}", part, archive) for key, part in node.items()}


def _check_promises(tree: Any, archive: zipfile.ZipFile, size: int) -> None:
    """Raise a ValueError where header or members promise more numbers than a file of `size` bytes is believed to."""
    promised = max(sum(_promised(tree)), sum(member.file_size for member in archive.infolist()))
    if promised > SMALL + MOST_EXPANSION * size:
        raise ValueError(f"it promises {promised:,} numbers, and has {size:,} bytes")


def _promised(node: Any) -> Iterator[int]:
    """How many numbers each of the tensors of the header holds."""
    if not isinstance(node, dict):
        return
    if SET in node:
        count, fields = node[SET]["count"], node[SET]["fields"].values()
        yield from (_product([count, *field.get("shape", [3])]) for field in fields)
    elif TENSOR in node:
        yield _product(node["shape"])
    else:
        for part in node.values():
            yield from _promised(part)


def _product(lengths: list[int]) -> int:
    if not all(isinstance(length, int) and length >= 0 for length in lengths):
        raise ValueError(f"lengths are {lengths}, expected whole numbers")
    return math.prod(lengths)


def _parts(name: str, values: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """The arrays that this one becomes, by their names: itself, or flat ones of PART bytes."""
    if values.nbytes <= PART:
        yield name, values
        return
    flat, length = values.reshape(-1), PART // values.itemsize
    for index, start in enumerate(range(0, len(flat), length)):
        yield f"{name}.{index}", flat[start : start + length]


def _array(archive: zipfile.ZipFile, name: str, kind: str, shape: list[int]) -> NDArray[Any]:
    """The array, of one member or of several, which has to have this type and shape."""
    names = set(archive.namelist())
    if f"{name}.0.npy" in names:
        numbers = takewhile(lambda index: f"{name}.{index}.npy" in names, count())
        parts = [_npy_of(archive, f"{name}.{index}", kind) for index in numbers]
        values = np.concatenate([part.reshape(-1) for part in parts])
        if len(values) != _product(shape):
            raise ValueError(f"{name} has {len(values):,} numbers in its parts, the header says {shape}")
        return values.reshape(shape)
    values = _npy_of(archive, name, kind)
    if list(values.shape) != shape:
        raise ValueError(f"{name} is {values.dtype} {list(values.shape)}, the header says {kind} {shape}")
    return values


def _npy(values: NDArray[Any]) -> bytes:
    content = io.BytesIO()
    np.lib.format.write_array(content, values, allow_pickle=False)
    return content.getvalue()


def _npy_of(archive: zipfile.ZipFile, name: str, kind: str) -> NDArray[Any]:
    values: NDArray[Any] = np.lib.format.read_array(io.BytesIO(_content(archive, f"{name}.npy")), allow_pickle=False)
    if values.dtype != kind:
        raise ValueError(f"{name} is {values.dtype} {list(values.shape)}, the header says {kind}")
    return values


def _content(archive: zipfile.ZipFile, name: str, most: int | None = None) -> bytes:
    member = archive.getinfo(name)
    if most is not None and member.file_size > most:
        raise ValueError(f"{name} has {member.file_size:,} bytes, more than the {most:,} that it may have")
    return archive.read(member)  # no more than `file_size` bytes, and only where its checksum is right
