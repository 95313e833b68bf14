"""Scenes: what every source's views and points say, held against each other."""

from __future__ import annotations

from envgs_bench.core import Scene

from .colors import check_colors
from .intrinsics import check_views
from .pictures import check_pictures
from .points import check_points
from .poses import check_poses


def check_scene(scene: Scene, where: str) -> None:
    """Refuse a scene that cannot be, whatever source it is from, and note what is odd.

    Takes a few milliseconds a view.

    Args:
        where: names the data in messages.

    Raises:
        DatasetError: the message names the views, what contradicts what, and the remedy.
    """
    views = [*scene.train, *scene.test]
    check_views(where, views)
    check_poses(where, views)
    check_points(where, views, scene.points)
    check_pictures(where, views)
    check_colors(where, views, scene.points, scene.point_colors)
