"""Scenes kept on disk once made: one file a scene, named after what determines it."""

from __future__ import annotations

import hashlib
import json
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from envgs_bench.core import Scene
from envgs_bench.file_lock import one_at_a_time

from ..errors import DatasetError
from ..notes import collecting, note
from ..progress import report
from .scene_file import LAYOUT, GrowingFile, read_scene

_may_make: ContextVar[bool] = ContextVar("may_make", default=True)


class NotCached(DatasetError):
    """The cache does not hold the scene, and it is not to be made."""


@contextmanager
def nothing_made() -> Iterator[None]:
    """A block in which a scene that is not in the cache is a NotCached."""
    token = _may_make.set(False)
    try:
        yield
    finally:
        _may_make.reset(token)


def cached_scene(cache_dir: Path, name: str, key: Mapping[str, Any], make: Callable[[], Scene]) -> Scene:
    """The scene stored under `key`, or else `make()`'s, which is then stored.

    Of several processes that ask at once one makes it, and the others wait. A file that cannot be read, or is not as it
    was written, is made again. Where nothing can be written the scene is returned nevertheless, with a note. What
    `make` notes is said again whenever the scene is read. It may put views into the file while others are still to be
    made: see `on_disk`.

    Args:
        cache_dir: made if missing.
        name: what the file's name begins with, for people.
        key: all that determines the scene, as JSON holds it.

    Raises:
        NotCached: it would have to be made within `nothing_made`.
    """
    text = json.dumps({"layout": LAYOUT, **key}, sort_keys=True)
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    path = cache_dir / "scenes" / f"{re.sub(r'[^A-Za-z0-9._-]+', '-', name)}-{digest}.scene"
    scene = _stored(path)
    if scene is None and not _may_make.get():
        raise NotCached(f"{path.parent}: does not hold the scene {name}")
    if scene is None:
        with one_at_a_time(path.with_suffix(".lock"), _say_that_it_waits):
            scene = _stored(path)  # that another process made meanwhile
            if scene is None:
                scene = _made(path, make)
    return scene


def _say_that_it_waits() -> None:
    report("waiting for another process that makes this scene", 0, 1)


def _stored(path: Path) -> Scene | None:
    """The scene of that file, None where there is none that can be read; such a file goes."""
    if not path.is_file():
        return None
    try:
        scene, notes = read_scene(path)
    except (OSError, KeyError, ValueError, TypeError) as error:
        warnings.warn(f"{path} cannot be read ({error}); it is made again", stacklevel=3)
        with suppress(OSError):
            path.unlink()
        return None
    for text in notes:
        note(text)
    return scene


def _made(path: Path, make: Callable[[], Scene]) -> Scene:
    """The scene that `make` makes, in that file if it can be written."""
    with GrowingFile(path) as file, collecting() as notes:
        scene = make()
        try:
            file.finish(scene, notes)
            return read_scene(path, check=False)[0]
        except OSError as error:
            note(f"the scene could not be cached in {path.parent}, and is made again for each run: {error}")
            return scene
