"""Files of Gaussians that any program wrote, read by their names' ending."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from torch import Tensor

from .ply import read_ply
from .sog_file import META, read_sog
from .spz_file import read_spz

READERS: dict[str, Callable[[Path], dict[str, Tensor]]] = {
    ".ply": partial(read_ply, checked=False),
    ".spz": read_spz,
    ".sog": read_sog,
}


def is_gaussian_file(path: Path) -> bool:
    """Whether the path's name is that of a file that `read_gaussian_file` reads."""
    return path.suffix.lower() in READERS or path.name == META


def read_gaussian_file(path: Path) -> dict[str, Tensor]:
    """`GaussianParameters`' tensors of a PLY of 3DGS or 2DGS, an SPZ or a SOG, packed or as a folder.

    Values are those of the file: some trainers leave Gaussians that have none, see `drawable`.

    Raises:
        ValueError: another file, or as the readers.
    """
    if path.name == META:
        return read_sog(path.parent)
    if path.suffix.lower() not in READERS:
        raise ValueError(f"{path}: is no file of Gaussians that is read; expected one of {', '.join(READERS)}")
    return READERS[path.suffix.lower()](path)


def drawable(tensors: dict[str, Tensor]) -> Tensor:
    """[N] bool: the Gaussians whose values are all finite and whose rotation is one; nobody can draw the others."""
    found = tensors["quaternions"].abs().amax(1) > 0
    for values in tensors.values():
        found &= values.isfinite().reshape(len(values), values[:1].numel()).all(1)
    return found
