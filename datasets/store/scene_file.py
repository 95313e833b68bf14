"""Scene files: the bytes of all tensors, then JSON that says what they are, then the length of that JSON and MAGIC.

A file grows while its scene is made, so that the tensors need not fit into memory together, and is mapped when read.
"""

from __future__ import annotations

import json
import math
import mmap
import os
import struct
import uuid
from collections.abc import Callable, Iterable, Sequence
from contextvars import ContextVar
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np
import torch
from torch import Tensor

from envgs_bench.core import Camera, Scene, View

LAYOUT = 3  # raise it with every change of `_as_dict`
MAGIC = b"envgs-scene\0"
ALIGNMENT = 64  # bytes
FOOTER = struct.Struct(f"<Q{len(MAGIC)}s")
DTYPES = {str(dtype): dtype for dtype in (torch.uint8, torch.bool, torch.float32, torch.float64)}

_growing: ContextVar[GrowingFile | None] = ContextVar("growing", default=None)


def on_disk(views: Iterable[View]) -> list[View]:
    """The views, each put into the file of the scene that is being made as soon as it is there, and mapped from it.

    Where no file is (no `GrowingFile` is entered, or nothing can be written), they stay in memory.
    """
    file = _growing.get()
    return list(views) if file is None else [file.kept(view) for view in views]


class GrowingFile:
    """The file of a scene that is being made: beside `path` until `finish`, so that a crash leaves none cut short.

    A context: within it, `on_disk` puts views into the file; after it, what was not finished is gone.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._part = path.with_name(f"{path.stem}-{uuid.uuid4().hex}.part")
        self._stream: BinaryIO | None = None
        self._blocks: dict[int, tuple[Tensor, list[Any]]] = {}  # by the tensor's id, which it keeps while it is here
        self._failure: OSError | None = None

    def __enter__(self) -> GrowingFile:
        self._token = _growing.set(self)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        _growing.reset(self._token)
        if self._stream is not None:
            self._stream.close()
            self._part.unlink(missing_ok=True)

    def kept(self, view: View) -> View:
        """The view with its tensors in the file, and mapped; those that are there already stay as they are."""
        return replace(
            view,
            image=self._kept(view.image),
            masks={region: self._kept(mask) for region, mask in view.masks.items()},
            normal=None if view.normal is None else self._kept(view.normal),
            depth=None if view.depth is None else self._kept(view.depth),
        )

    def finish(self, scene: Scene, notes: Sequence[str]) -> None:
        """Complete the file with all that it still lacks, and put it in its place.

        Raises:
            OSError: it cannot be written, or could not before.
        """
        if self._failure is not None:
            raise self._failure
        index = json.dumps({"scene": _as_dict(scene, self._block), "notes": list(notes)}).encode()
        stream = self._open()
        stream.write(index + FOOTER.pack(len(index), MAGIC))
        stream.close()
        os.replace(self._part, self._path)

    def _kept(self, tensor: Tensor) -> Tensor:
        if self._failure is not None or not tensor.numel() or id(tensor) in self._blocks:
            return tensor
        try:
            block = self._append(tensor)
            mapped = _mapped(self._part, *block)
        except OSError as error:
            self._failure = error
            return tensor
        self._blocks[id(mapped)] = mapped, block
        return mapped

    def _block(self, tensor: Tensor) -> list[Any]:
        """Where the tensor lies in the file, which it is written to unless it is there."""
        if id(tensor) not in self._blocks:
            self._blocks[id(tensor)] = tensor, self._append(tensor)
        return self._blocks[id(tensor)][1]

    def _append(self, tensor: Tensor) -> list[Any]:
        """Write the tensor; where it begins, its dtype and its shape."""
        stream = self._open()
        stream.write(bytes(-stream.tell() % ALIGNMENT))
        offset = stream.tell()
        stream.write(np.ascontiguousarray(tensor.numpy()).data)
        stream.flush()
        return [offset, str(tensor.dtype), list(tensor.shape)]

    def _open(self) -> BinaryIO:
        if self._stream is None:
            self._part.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self._part.open("wb")
        return self._stream


def _mapped(path: Path, offset: int, dtype: str, shape: list[int]) -> Tensor:
    """The tensor at that place of the file; writing into it changes this process's copy only."""
    numpy_dtype = torch.empty(0, dtype=DTYPES[dtype]).numpy().dtype
    return torch.from_numpy(np.memmap(path, numpy_dtype, "c", offset, tuple(shape)))


def read_scene(path: Path) -> tuple[Scene, list[str]]:
    """The scene, its tensors mapped from the file, and what was noted while it was made.

    Raises:
        OSError, KeyError, ValueError, TypeError: it is no such file, or not a whole one.
    """
    with path.open("rb") as stream:
        size = path.stat().st_size
        stream.seek(max(0, size - FOOTER.size))
        footer = stream.read()
        if len(footer) < FOOTER.size or not footer.endswith(MAGIC):
            raise ValueError("it is cut short")
        length = FOOTER.unpack(footer)[0]
        stream.seek(size - FOOTER.size - length)
        content = json.loads(stream.read(length))
        pages = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_COPY)

    def tensor(block: list[Any]) -> Tensor:
        offset, dtype, shape = block
        count = math.prod(shape)
        if not count:
            return torch.empty(shape, dtype=DTYPES[dtype])
        return torch.frombuffer(pages, dtype=DTYPES[dtype], count=count, offset=offset).reshape(shape)

    return _from_dict(content["scene"], tensor), content["notes"]


def _as_dict(scene: Scene, block: Callable[[Tensor], list[Any]]) -> dict[str, Any]:
    def view_as_dict(view: View) -> dict[str, Any]:
        camera = view.camera
        return {
            "name": view.name,
            "camera": [camera.world_to_camera.tolist(), camera.intrinsics.tolist(), camera.width, camera.height],
            "image": block(view.image),
            "masks": {region: block(mask) for region, mask in view.masks.items()},
            "normal": None if view.normal is None else block(view.normal),
            "depth": None if view.depth is None else block(view.depth),
        }

    return {
        "name": scene.name,
        "train": [view_as_dict(view) for view in scene.train],
        "test": [view_as_dict(view) for view in scene.test],
        "val": [view_as_dict(view) for view in scene.val],
        "points": block(scene.points),
        "point_colors": block(scene.point_colors),
        "background": scene.background.tolist(),
    }


def _from_dict(content: dict[str, Any], tensor: Callable[[list[Any]], Tensor]) -> Scene:
    def view_from_dict(view: dict[str, Any]) -> View:
        pose, intrinsics, width, height = view["camera"]
        return View(
            name=view["name"],
            camera=Camera(torch.tensor(pose), torch.tensor(intrinsics), width, height),
            image=tensor(view["image"]),
            masks={region: tensor(block) for region, block in view["masks"].items()},
            normal=None if view["normal"] is None else tensor(view["normal"]),
            depth=None if view["depth"] is None else tensor(view["depth"]),
        )

    return Scene(
        name=content["name"],
        train=[view_from_dict(view) for view in content["train"]],
        test=[view_from_dict(view) for view in content["test"]],
        val=[view_from_dict(view) for view in content["val"]],
        points=tensor(content["points"]),
        point_colors=tensor(content["point_colors"]),
        background=torch.tensor(content["background"]),
    )
