"""PLY: a set of Gaussians in the layout of 3DGS, which viewers and other programs read, or in that of 2DGS.

One element `vertex` of float32 properties, a row a Gaussian, values as they are trained (not activated):

| properties | what |
|---|---|
| x y z | mean |
| nx ny nz | written as 0, not read |
| f_dc_0 … f_dc_2 | the constant SH coefficient of red, green, blue: all that other programs show of a set with sites |
| f_rest_0 … | the other coefficients, all of red, then all of green, then all of blue |
| opacity | logit |
| scale_0 scale_1 scale_2 | logarithms; a surfel's third is its thickness, FLAT_SCALE, or left out as in 2DGS |
| rot_0 … rot_3 | quaternion, wxyz, of any length |
| beta | logit of EnvGS's blending weight; our addition, where the set has one |
| material_<field>_0 … | a method's own field, as it is trained, sites among them; our addition |
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement
from torch import Tensor

from envgs_bench.core import GaussianSet
from envgs_bench.ply_file import number_names, read_elements

from ..gaussians.parameters import activated, material_fields

MEAN, NORMAL, OPACITY, BETA = ("x", "y", "z"), ("nx", "ny", "nz"), ("opacity",), ("beta",)
DC, ROTATION = tuple(f"f_dc_{i}" for i in range(3)), tuple(f"rot_{i}" for i in range(4))
MATERIAL = re.compile(r"material_(\w+)_\d+")
REST_COUNTS = tuple(3 * ((degree + 1) ** 2 - 1) for degree in range(4))

# A surfel's third scale, world units: viewers know three scales, and refuse or misread two. This one is what 2DGS's
# author advises to add (hbb1/2d-gaussian-splatting, issue 94).
FLAT_SCALE = 1e-6
FLAT = np.float32(math.log(FLAT_SCALE))

Values = NDArray[np.float32]


def write_ply(path: Path, tensors: Mapping[str, Tensor], two_scales: bool = False) -> None:
    """Write `GaussianParameters`' tensors as a binary PLY; the folder is made where missing.

    Args:
        two_scales: leave out a surfel's third scale, as 2DGS does; 3D Gaussians have three in any case.
    """
    rows = {name: value.detach().cpu().float().numpy() for name, value in tensors.items()}
    count, axes = rows["log_scales"].shape
    columns: dict[str, Values] = {}
    columns |= _named(MEAN, rows["means"])
    columns |= _named(NORMAL, np.zeros((count, 3), np.float32))
    columns |= _named(DC, rows["sh_dc"].reshape(count, 3))
    rest = (
        rows["sh_rest"].swapaxes(1, 2).reshape(count, 3 * rows["sh_rest"].shape[1])
    )  # coefficients of one channel side by side
    columns |= _named(_numbered("f_rest", rest.shape[1]), rest)
    columns |= _named(OPACITY, rows["opacity_logits"][:, None])
    columns |= _named(_numbered("scale", axes), rows["log_scales"])
    if axes == 2 and not two_scales:
        columns["scale_2"] = np.full(count, FLAT)
    columns |= _named(ROTATION, rows["quaternions"])
    if "beta_logits" in rows:
        columns |= _named(BETA, rows["beta_logits"])
    for name in material_fields(rows):
        columns |= _named(_numbered(f"material_{name}", rows[name].shape[1]), rows[name])
    table = np.empty(count, dtype=[(name, "<f4") for name in columns])
    for name, values in columns.items():
        table[name] = values
    path.parent.mkdir(parents=True, exist_ok=True)
    PlyData([PlyElement.describe(table, "vertex")], byte_order="<").write(path)


def read_ply(path: Path, checked: bool = True) -> dict[str, Tensor]:
    """`GaussianParameters`' tensors, float32, of what `write_ply` or another program wrote; the rest is left.

    Surfels are those whose file has two scales, or a third that is FLAT_SCALE of all of them.

    Args:
        checked: refuse values that no Gaussian has; otherwise they are returned as they are.

    Raises:
        ValueError: no readable PLY, a compressed one, properties missing, an SH degree above 3, or values that no
            Gaussian has; the message names the file and the properties.
    """
    return vertex_tensors(_vertices(path), path, checked)


def vertex_tensors(vertices: PlyElement, path: Path | str, checked: bool = True) -> dict[str, Tensor]:
    """As `read_ply`, of the element `vertex` of the file at `path`, which errors name."""
    present = number_names(vertices)
    rest, scales = (sorted(n for n in present if n.startswith(prefix)) for prefix in ("f_rest_", "scale_"))
    axes = 3 if "scale_2" in scales else 2
    materials = _materials(present)
    own = [name for names in materials.values() for name in names]
    needed = (*MEAN, *DC, *OPACITY, *_numbered("scale", axes), *ROTATION, *own)
    missing = [name for name in needed if name not in present]
    if missing:
        raise ValueError(
            f"{path}: has no property {', '.join(missing)}; a set of Gaussians needs {', '.join(needed)}. "
            f"It has {', '.join(present) or 'none'}"
        )
    if len(rest) not in REST_COUNTS or set(rest) != set(_numbered("f_rest", len(rest))):
        raise ValueError(
            f"{path}: has {len(rest)} properties f_rest_…, expected f_rest_0 and on, "
            f"{', '.join(map(str, REST_COUNTS))} in all (SH degree 0, 1, 2, 3)"
        )

    def columns(names: tuple[str, ...]) -> Tensor:
        values = [np.asarray(vertices[name], np.float32) for name in names]
        return torch.from_numpy(np.stack(values, axis=-1) if values else np.empty((len(vertices.data), 0), np.float32))

    count = len(vertices.data)
    if axes == 3 and (columns(("scale_2",)) == float(FLAT)).all():
        axes = 2
    tensors = {
        "means": columns(MEAN),
        "quaternions": columns(ROTATION),
        "log_scales": columns(_numbered("scale", axes)),
        "opacity_logits": columns(OPACITY)[:, 0].clone(),
        "sh_dc": columns(DC)[:, None],
        "sh_rest": columns(_numbered("f_rest", len(rest))).reshape(count, 3, len(rest) // 3).mT.contiguous(),
    }
    if "beta" in present:
        tensors["beta_logits"] = columns(BETA)
    tensors |= {name: columns(properties) for name, properties in materials.items()}
    if checked:
        _check_values(path, tensors)
    return tensors


def read_gaussians(path: Path) -> GaussianSet:
    """The file as a set to be drawn: `rasterize(read_gaussians(path), camera)`. Raises as `read_ply`."""
    return activated(read_ply(path))


def _vertices(path: Path) -> PlyElement:
    elements = read_elements(path)
    if "chunk" in elements or ("vertex" in elements and "packed_position" in elements["vertex"].data.dtype.names):
        raise ValueError(
            f"{path}: is in a compressed layout of splats (packed_position …), which is not read; "
            "export it as an uncompressed PLY"
        )
    if "vertex" not in elements:
        raise ValueError(f"{path}: has no element vertex, only {', '.join(elements) or 'none'}")
    return elements["vertex"]


def _check_values(path: Path | str, tensors: Mapping[str, Tensor]) -> None:
    for name, values in tensors.items():
        bad = int((~values.isfinite()).flatten(1).any(1).sum()) if values.ndim > 1 else int((~values.isfinite()).sum())
        if bad:
            raise ValueError(f"{path}: {bad} of {len(values)} Gaussians have {name} that are not finite; remove them")
    flat = int((tensors["quaternions"].abs().amax(1) == 0).sum()) if len(tensors["quaternions"]) else 0
    if flat:
        raise ValueError(f"{path}: {flat} Gaussians have a rotation of four zeros; remove them")


def _materials(present: list[str]) -> dict[str, tuple[str, ...]]:
    """The properties of each material field, in their order."""
    names = [match[1] for name in present if (match := MATERIAL.fullmatch(name))]
    return {name: _numbered(f"material_{name}", names.count(name)) for name in sorted(set(names))}


def _named(names: tuple[str, ...], values: Values) -> dict[str, Values]:
    return {name: values[:, index] for index, name in enumerate(names)}


def _numbered(name: str, count: int) -> tuple[str, ...]:
    return tuple(f"{name}_{index}" for index in range(count))
