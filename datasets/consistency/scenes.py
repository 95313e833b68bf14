"""Scenes: what every source's views and points say, held against each other."""

from __future__ import annotations

from envgs_bench.core import Scene

from . import intrinsics


def check_scene(scene: Scene) -> None:
    """Refuse a scene that cannot be, whatever source it is from, and note what is odd.

    Raises:
        DatasetError: the message names the views, what contradicts what, and the remedy.
    """
    intrinsics.check_views([*scene.train, *scene.val, *scene.test])
