"""Scenes kept on disk once made: one file a scene, named after what determines it."""

from __future__ import annotations

import hashlib
import json
import re
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from envgs_bench.core import Scene

from ..notes import collecting, note
from .scene_file import LAYOUT, GrowingFile, read_scene


def cached_scene(cache_dir: Path, name: str, key: Mapping[str, Any], make: Callable[[], Scene]) -> Scene:
    """The scene stored under `key`, or else `make()`'s, which is then stored.

    Several processes may do this at once. A file that cannot be read, or is not as it was
    written, is made again. Where nothing can be written the
    scene is returned nevertheless, with a warning. What `make` notes is said again whenever the scene is read. It may
    put views into the file while others are still to be made: see `on_disk`.

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
            scene, notes = read_scene(path)
        except (OSError, KeyError, ValueError, TypeError) as error:
            warnings.warn(f"{path} cannot be read ({error}); it is made again", stacklevel=2)
        else:
            for text in notes:
                note(text)
            return scene
    with GrowingFile(path) as file, collecting() as notes:
        scene = make()
        try:
            file.finish(scene, notes)
            return read_scene(path, check=False)[0]
        except OSError as error:
            warnings.warn(f"the scene could not be cached in {path.parent}: {error}", stacklevel=2)
            return scene
