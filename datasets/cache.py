"""Scenes kept on disk once made: one file a scene, named after what determines it, mapped into memory when read."""

from __future__ import annotations

import hashlib
import json
import os
import re
import uuid
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch

from envgs_bench.core import Camera, Scene, View

LAYOUT = 1  # of the cached files; raise it with every change of `_as_dict`


def cached_scene(cache_dir: Path, name: str, key: Mapping[str, Any], make: Callable[[], Scene]) -> Scene:
    """The scene stored under `key`, or else `make()`'s, which is then stored.

    The file is written beside its place and renamed into it, so that a crash leaves none that is cut short and several
    processes may do this at once. One that cannot be read all the same is made again. Where nothing can be written
    the scene is returned nevertheless, with a warning.

    Args:
        cache_dir: made if missing.
        name: what the file's name begins with, for people.
        key: all that determines the scene, as JSON holds it.
    """
    text = json.dumps({"layout": LAYOUT, **key}, sort_keys=True)
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    path = cache_dir / "scenes" / f"{re.sub(r'[^A-Za-z0-9._-]+', '-', name)}-{digest}.pt"
    if path.is_file():
        try:
            return _from_dict(torch.load(path, mmap=True, weights_only=True))
        except (OSError, RuntimeError, KeyError, ValueError) as error:
            warnings.warn(f"{path} cannot be read ({error}); it is made again", stacklevel=2)
    scene = make()
    try:
        _write(path, _as_dict(scene))
    except OSError as error:
        warnings.warn(f"the scene could not be cached in {path.parent}: {error}", stacklevel=2)
    return scene


def _write(path: Path, content: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f"{path.stem}-{uuid.uuid4().hex}.part")
    try:
        torch.save(content, temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _as_dict(scene: Scene) -> dict[str, Any]:
    def view_as_dict(view: View) -> dict[str, Any]:
        camera = view.camera
        return {
            "name": view.name,
            "camera": [camera.world_to_camera, camera.intrinsics, camera.width, camera.height],
            "image": view.image,
            "masks": dict(view.masks),
            "normal": view.normal,
            "depth": view.depth,
        }

    return {
        "name": scene.name,
        "train": [view_as_dict(view) for view in scene.train],
        "test": [view_as_dict(view) for view in scene.test],
        "points": scene.points,
        "point_colors": scene.point_colors,
        "background": scene.background,
    }


def _from_dict(content: dict[str, Any]) -> Scene:
    def view_from_dict(view: dict[str, Any]) -> View:
        return View(**{**view, "camera": Camera(*view["camera"])})

    views = {split: [view_from_dict(view) for view in content[split]] for split in ("train", "test")}
    return Scene(**{**content, **views})
