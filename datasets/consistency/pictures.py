"""Pictures: whether each is another one."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import torch
from numpy.typing import NDArray

from envgs_bench.core import View

from ..errors import listed
from ..notes import note

PIXELS = 16  # along each edge that are compared


def check_pictures(where: str, views: Sequence[View]) -> None:
    """Note views that show the same picture as another: copies, of which one may train and the other test.

    Pictures of one color say nothing and are left out.
    """
    alike: dict[tuple[int, int, int], list[View]] = {}
    for view in views:
        few = _thinned(view.image.cpu().numpy())
        if (few != few[0, 0]).any():
            height, width = view.image.shape[:2]
            alike.setdefault((width, height, zlib.crc32(few.tobytes())), []).append(view)
    same = [group for group in alike.values() if len(group) > 1 and _equal(group)]
    names = [view.name for group in same for view in group]
    if not names:
        return
    posed = any(
        not torch.equal(a.camera.world_to_camera, group[0].camera.world_to_camera) for group in same for a in group
    )
    what = "though their poses differ: check which image is which" if posed else "at one pose: remove the copies"
    note(
        f"{where}: {len(names)} of {len(views)} views show exactly the picture of another one, {what}: {listed(names)}"
    )


def _thinned(picture: NDArray) -> NDArray:
    """Some pixels [h, w, 3], evenly."""
    height, width = picture.shape[:2]
    return picture[:: max(1, height // PIXELS), :: max(1, width // PIXELS)]


def _equal(group: Sequence[View]) -> bool:
    return all(torch.equal(group[0].image, view.image) for view in group[1:])
