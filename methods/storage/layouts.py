"""Layouts: in what files a trained model can be stored, what each of them cannot hold, and how it is read back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from torch import Tensor

from ..gaussians.model import GaussianModel
from ..gaussians.parameters import material_fields
from .compact import State, read_compact, write_compact
from .ply import read_ply, write_ply
from .splats import SPLAT_LAYOUTS, decode_splats, encode_splats

OWN_PLACE = ("background",)  # the state's tensors that a data set knows, so that a file of Gaussians need not


class Stored(Protocol):
    """A method whose model can be stored: its sets, and all that is stored of it."""

    model: GaussianModel

    def state(self) -> dict[str, Any]: ...


@dataclass(frozen=True)
class Layout:
    """One way to store a model.

    Attributes:
        what: it, in words.
        write: writes a method's model into a folder, made where missing, and returns the files. What `lacks` names is
            left out. Raises ValueError where the model cannot be stored.
        read: the state, as of `Stored.state`, that files written by `write` hold; what of it is no Gaussian's
            comes from the method's own, where the layout has no place for it.
        lacks: what of a method's model the layout has no place for, in words.
    """

    what: str
    write: Callable[[Stored, Path], list[Path]]
    read: Callable[[Stored, Path], State]
    lacks: Callable[[Stored], list[str]]


def _nothing(method: Stored) -> list[str]:
    return []


def _maps(method: Stored) -> list[str]:
    """The state's tensors that are no set's: a cube map's texels."""
    return [name for name, value in method.state().items() if isinstance(value, Tensor) and name not in OWN_PLACE]


def _beta_and_maps(method: Stored) -> list[str]:
    """And a method's own fields of its primitives."""
    fields = {name for tensors in _sets(method).values() for name in tensors}
    beta = ["β"] if "beta_logits" in fields else []
    return [*beta, *material_fields(dict.fromkeys(fields)), *_maps(method)]


def _write_compact(method: Stored, folder: Path) -> list[Path]:
    return [write_compact(folder, type(method).__name__, method.state())]


def _read_compact(method: Stored, folder: Path) -> State:
    return read_compact(folder, type(method).__name__)


def _write_ply(two_scales: bool, method: Stored, folder: Path) -> list[Path]:
    paths = {name: folder / f"{name}.ply" for name in method.model.sets}
    for name, tensors in _sets(method).items():
        write_ply(paths[name], tensors, two_scales)
    return list(paths.values())


def _read_ply(method: Stored, folder: Path) -> State:
    return method.state() | {"sets": {name: read_ply(folder / f"{name}.ply") for name in method.model.sets}}


def _write_splats(layout: str, method: Stored, folder: Path) -> list[Path]:
    contents = {name: encode_splats(layout, tensors) for name, tensors in _sets(method).items()}
    folder.mkdir(parents=True, exist_ok=True)
    paths = {name: folder / f"{name}.{SPLAT_LAYOUTS[layout]}" for name in contents}
    for name, content in contents.items():
        paths[name].write_bytes(content)
    return list(paths.values())


def _read_splats(layout: str, method: Stored, folder: Path) -> State:
    def tensors(name: str) -> dict[str, Tensor]:
        return decode_splats(layout, (folder / f"{name}.{SPLAT_LAYOUTS[layout]}").read_bytes(), method.model.axes)

    return method.state() | {"sets": {name: tensors(name) for name in method.model.sets}}


def _sets(method: Stored) -> dict[str, dict[str, Tensor]]:
    return {name: trained.parameters.detached() for name, trained in method.model.sets.items()}


def _ply(what: str, two_scales: bool) -> Layout:
    return Layout(what, partial(_write_ply, two_scales), _read_ply, _maps)


def _splats(layout: str, what: str) -> Layout:
    return Layout(what, partial(_write_splats, layout), partial(_read_splats, layout), _beta_and_maps)


LAYOUTS = {
    "ply": _ply("float32, lossless, a file a set, as viewers open it: surfels have a third scale", two_scales=False),
    "compact": Layout("one small lossy file for the whole model", _write_compact, _read_compact, _nothing),
    "spz": _splats("spz", "Niantic's, lossy, a file a set, for viewers"),
    "sog": _splats("sog", "PlayCanvas's, lossy, a file a set, for viewers"),
    "compressed-ply": _splats("compressed-ply", "PlayCanvas's compressed PLY, lossy, a file a set, for viewers"),
    "ply-two-scales": _ply("as ply, but surfels have two scales, as 2DGS writes and reads them", two_scales=True),
}


def stored_bytes(paths: list[Path]) -> int:
    """Bytes of the files together."""
    return sum(path.stat().st_size for path in paths)
