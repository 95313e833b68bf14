"""Regions: what the masks of a scene's views leave to be scored."""

from __future__ import annotations

from collections.abc import Sequence

from envgs_bench.core import Scene, View

from .errors import DatasetError
from .notes import note


def check_regions(scene: Scene) -> None:
    """Refuse a region without a pixel in any view, and note one without any in the views that are scored.

    Raises:
        DatasetError: a region's masks are empty, as after reduction; the message names it.
    """
    for region in dict.fromkeys(region for view in (*scene.train, *scene.test) for region in view.masks):
        if _is_somewhere(region, scene.test):
            continue
        if not _is_somewhere(region, scene.train):
            raise DatasetError(
                f"data set {scene.name}: region {region} is empty in every view; mark what is inside in its masks (at "
                "a smaller dataset.downsample, where it is tiny), or move them away"
            )
        note(f"data set {scene.name}: region {region} is in training views only, so that no test view scores it")


def _is_somewhere(region: str, views: Sequence[View]) -> bool:
    return any(region in view.masks and bool(view.masks[region].any()) for view in views)
