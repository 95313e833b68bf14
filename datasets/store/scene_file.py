"""Scene files: the bytes of all tensors, then JSON that says what they are, then its length, its CRC-32 and MAGIC.

A file grows while its scene is made, so that the tensors need not fit into memory together, and is mapped when read.
The JSON holds the CRC-32 of each tensor's bytes: a disk that lost some must not make another scene of this one. zlib's
is the fastest checksum of the standard library, 3 GB/s a core, three times SHA-256, and all that chance asks for.
"""

from __future__ import annotations

import json
import math
import mmap
import os
import struct
import uuid
import zlib
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import asdict, replace
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np
import torch
from torch import Tensor

from envgs_bench.core import Camera, Placement, Scene, View

from ..progress import mapped

LAYOUT = 6  # raise it with every change of `_as_dict`
MAGIC = b"envgs-scene\0"
ALIGNMENT = 64  # bytes
FOOTER = struct.Struct(f"<QI{len(MAGIC)}s")
CHUNK = 1 << 20  # bytes read at once to be checked
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
            with suppress(OSError):  # of a full disk, which closing tries to write to once more
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
        stream.write(index + FOOTER.pack(len(index), zlib.crc32(index), MAGIC))
        stream.close()
        os.replace(self._part, self._path)

    def _kept(self, tensor: Tensor) -> Tensor:
        if self._failure is not None or not tensor.numel() or id(tensor) in self._blocks:
            return tensor
        try:
            block = self._append(tensor)
            on_file = _mapped(self._part, *block[:3])
        except OSError as error:
            self._failure = error
            return tensor
        self._blocks[id(on_file)] = on_file, block
        return on_file

    def _block(self, tensor: Tensor) -> list[Any]:
        """Where the tensor lies in the file, which it is written to unless it is there."""
        if id(tensor) not in self._blocks:
            self._blocks[id(tensor)] = tensor, self._append(tensor)
        return self._blocks[id(tensor)][1]

    def _append(self, tensor: Tensor) -> list[Any]:
        """Write the tensor; where it begins, its dtype, its shape and its checksum."""
        stream = self._open()
        stream.write(bytes(-stream.tell() % ALIGNMENT))
        offset = stream.tell()
        content = np.ascontiguousarray(tensor.numpy()).data
        stream.write(content)
        stream.flush()
        return [offset, str(tensor.dtype), list(tensor.shape), zlib.crc32(content)]

    def _open(self) -> BinaryIO:
        if self._stream is None:
            self._part.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self._part.open("wb")
        return self._stream


def _mapped(path: Path, offset: int, dtype: str, shape: list[int]) -> Tensor:
    """The tensor at that place of the file; writing into it changes this process's copy only."""
    numpy_dtype = torch.empty(0, dtype=DTYPES[dtype]).numpy().dtype
    return torch.from_numpy(np.memmap(path, numpy_dtype, "c", offset, tuple(shape)))


def read_scene(path: Path, check: bool = True) -> tuple[Scene, list[str]]:
    """The scene, its tensors mapped from the file, and what was noted while it was made.

    Args:
        check: compare all tensors with their checksums, which reads the whole file.

    Raises:
        OSError, KeyError, ValueError, TypeError: it is no such file, not a whole one, or not as it was written.
    """
    with path.open("rb") as stream:
        content = _index(stream, path.stat().st_size)
        pages = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_COPY)
    blocks: list[list[Any]] = []

    def tensor(block: list[Any]) -> Tensor:
        offset, dtype, shape, _ = block
        count = math.prod(shape)
        if not count:
            return torch.empty(shape, dtype=DTYPES[dtype])
        blocks.append(block)
        return torch.frombuffer(pages, dtype=DTYPES[dtype], count=count, offset=offset).reshape(shape)

    scene = _from_dict(content["scene"], tensor)
    if check and not all(mapped("checking the cached scene", lambda block: _is_whole(path, *block), blocks)):
        raise ValueError("it is damaged: what it holds is not what was written")
    return scene, content["notes"]


def _index(stream: BinaryIO, size: int) -> dict[str, Any]:
    stream.seek(max(0, size - FOOTER.size))
    footer = stream.read()
    if len(footer) < FOOTER.size or not footer.endswith(MAGIC):
        raise ValueError("it is cut short")
    length, checksum, _ = FOOTER.unpack(footer)
    if length > size - FOOTER.size:
        raise ValueError("it is damaged: its index would begin before the file does")
    stream.seek(size - FOOTER.size - length)
    index = stream.read(length)
    if zlib.crc32(index) != checksum:
        raise ValueError("it is damaged: its index is not what was written")
    return json.loads(index)


def _is_whole(path: Path, offset: int, dtype: str, shape: list[int], checksum: int) -> bool:
    """Whether the block's bytes are those that were written; read, not mapped, lest they count as memory in use."""
    left, found = math.prod(shape) * DTYPES[dtype].itemsize, 0
    with path.open("rb", buffering=0) as stream:
        stream.seek(offset)
        buffer = memoryview(bytearray(min(CHUNK, left)))
        while left and (count := stream.readinto(buffer[: min(CHUNK, left)])):
            found = zlib.crc32(buffer[:count], found)
            left -= count
    return not left and found == checksum


def _as_dict(scene: Scene, block: Callable[[Tensor], list[Any]]) -> dict[str, Any]:
    def view_as_dict(view: View) -> dict[str, Any]:
        camera = view.camera
        return {
            "name": view.name,
            "camera": [*map(_numbers, (camera.world_to_camera, camera.intrinsics)), camera.width, camera.height],
            "image": block(view.image),
            "masks": {region: block(mask) for region, mask in view.masks.items()},
            "normal": None if view.normal is None else block(view.normal),
            "depth": None if view.depth is None else block(view.depth),
        }

    unseen = {place: [view_as_dict(view) for view in views] for place, views in scene.unseen.items()}
    return {
        "name": scene.name,
        "train": [view_as_dict(view) for view in scene.train],
        "test": [view_as_dict(view) for view in scene.test],
        "val": [view_as_dict(view) for view in scene.val],
        **({"unseen": unseen} if unseen else {}),
        "points": block(scene.points),
        "point_colors": block(scene.point_colors),
        "background": _numbers(scene.background),
        "free_space": scene.free_space,
        "bounds": scene.bounds,
        "attributes": dict(scene.attributes),
        "placement": asdict(scene.placement),
    }


def _numbers(tensor: Tensor) -> list[Any]:
    """The tensor's dtype and values: float64 must not come back as float32."""
    return [str(tensor.dtype), tensor.tolist()]


def _tensor(dtype: str, values: list[Any]) -> Tensor:
    return torch.tensor(values, dtype=DTYPES[dtype])


def _from_dict(content: dict[str, Any], tensor: Callable[[list[Any]], Tensor]) -> Scene:
    def view_from_dict(view: dict[str, Any]) -> View:
        pose, intrinsics, width, height = view["camera"]
        return View(
            name=view["name"],
            camera=Camera(_tensor(*pose), _tensor(*intrinsics), width, height),
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
        unseen={place: [view_from_dict(view) for view in views] for place, views in content.get("unseen", {}).items()},
        points=tensor(content["points"]),
        point_colors=tensor(content["point_colors"]),
        background=_tensor(*content["background"]),
        free_space=content["free_space"],
        bounds=content["bounds"],
        attributes=content["attributes"],
        placement=Placement(tuple(content["placement"]["shift"]), content["placement"]["scale"]),
    )
