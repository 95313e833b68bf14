"""Scenes kept on disk once made: one file a scene, named after what determines it, mapped into memory when read.

A file holds the bytes of all tensors, then JSON that says what they are, then the length of that JSON and MAGIC.
"""

from __future__ import annotations

import hashlib
import json
import math
import mmap
import os
import re
import struct
import threading
import uuid
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import torch
from torch import Tensor

from envgs_bench.core import Camera, Scene, View

from .progress import log

LAYOUT = 2  # of the cached files; raise it with every change of `_as_dict`
MAGIC = b"envgs-scene\0"
ALIGNMENT = 64  # bytes
FOOTER = struct.Struct(f"<Q{len(MAGIC)}s")
DTYPES = {str(dtype): dtype for dtype in (torch.uint8, torch.bool, torch.float32, torch.float64)}


def cached_scene(cache_dir: Path, name: str, key: Mapping[str, Any], make: Callable[[], Scene]) -> Scene:
    """`drafted_scene` for a scene that fits into memory while it is made."""
    return drafted_scene(cache_dir, name, key, lambda draft: make())


def drafted_scene(cache_dir: Path, name: str, key: Mapping[str, Any], make: Callable[[Draft], Scene]) -> Scene:
    """The scene stored under `key`, or else `make(draft)`'s, which is then stored.

    The file is written beside its place and renamed into it, so that a crash leaves none that is cut short and several
    processes may do this at once. One that cannot be read all the same is made again. Where nothing can be written
    the scene is returned nevertheless, with a warning. What was noted while the scene was made is logged each time.

    Args:
        cache_dir: made if missing.
        name: what the file's name begins with, for people.
        key: all that determines the scene, as JSON holds it.
    """
    text = json.dumps({"layout": LAYOUT, **key}, sort_keys=True)
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    path = cache_dir / "scenes" / f"{re.sub(r'[^A-Za-z0-9._-]+', '-', name)}-{digest}.scene"
    if path.is_file():
        try:
            return _read(path)
        except (OSError, KeyError, ValueError, TypeError) as error:
            warnings.warn(f"{path} cannot be read ({error}); it is made again", stacklevel=2)
    draft = Draft(path)
    try:
        scene = make(draft)
        return draft.finish(scene)
    finally:
        draft.close()


class Draft:
    """The file of a scene that is being made."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._part = path.with_name(f"{path.stem}-{uuid.uuid4().hex}.part")
        self._stream: BinaryIO | None = None
        self._blocks: dict[int, list[Any]] = {}  # by the address of the mapped tensor
        self._notes: list[str] = []
        self._lock = threading.Lock()
        self._failure: OSError | None = None

    def keep(self, tensor: Tensor) -> Tensor:
        """The same tensor, now on disk and mapped: what is made does not pile up in memory. Any thread may call."""
        if self._failure is None and tensor.numel():
            try:
                block = self._append(tensor)
                mapped = _mapped(self._part, *block)
                self._blocks[mapped.data_ptr()] = block
                return mapped
            except OSError as error:
                self._failure = error
        return tensor

    def note(self, text: str) -> None:
        """Have the log say `text`, now and whenever the scene is loaded."""
        self._notes.append(text)
        log.warning(text)

    def finish(self, scene: Scene) -> Scene:
        """The scene as it is read from the finished file."""
        try:
            if self._failure:
                raise self._failure
            index = json.dumps({"scene": _as_dict(scene, self._block), "notes": self._notes}).encode()
            stream = self._open()
            stream.write(index + FOOTER.pack(len(index), MAGIC))
            stream.close()
            os.replace(self._part, self._path)
            return _read(self._path, log_notes=False)
        except OSError as error:
            warnings.warn(f"the scene could not be cached in {self._path.parent}: {error}", stacklevel=3)
            return scene

    def close(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._part.unlink(missing_ok=True)

    def _block(self, tensor: Tensor) -> list[Any]:
        return self._blocks.get(tensor.data_ptr()) or self._append(tensor)

    def _append(self, tensor: Tensor) -> list[Any]:
        """Write the tensor; where it begins, its dtype and its shape."""
        with self._lock:
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


def _read(path: Path, log_notes: bool = True) -> Scene:
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

    if log_notes:
        for note in content["notes"]:
            log.warning(note)
    return _from_dict(content["scene"], tensor)


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
        points=tensor(content["points"]),
        point_colors=tensor(content["point_colors"]),
        background=torch.tensor(content["background"]),
    )
