"""Points: whether they lie before the cameras, within what views show."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from envgs_bench.core import View

from ..errors import DatasetError, listed
from ..notes import note

LOOKED_AT = 2000  # points, evenly over all
FEWEST = 50  # of a cloud, to speak of it
AXES = "check the poses' axes (COLMAP: x right, y down, z forward; transforms.json: x right, y up, z backward)"


def check_points(where: str, views: Sequence[View], points: Tensor) -> None:
    """Refuse points that no view sees, and note views that see none of them.

    Raises:
        DatasetError: all lie behind the cameras, or beside all pictures.
    """
    if len(points) < FEWEST:
        return
    chosen = points[:: max(1, len(points) // LOOKED_AT)].double()
    seen, ahead = [], []
    for view in views:
        camera = view.camera
        pose, k = camera.world_to_camera.double(), camera.intrinsics.double()
        inside = chosen @ pose[:3, :3].T + pose[:3, 3]
        before = inside[:, 2] > 0
        x, y = ((inside @ k.T)[:, :2] / inside[:, 2:]).T
        seen.append(bool((before & (x > 0) & (x < camera.width) & (y > 0) & (y < camera.height)).any()))
        ahead.append(bool(before.any()))
    blind = [view.name for view, sees in zip(views, seen, strict=True) if not sees]
    if len(blind) == len(views):
        side = "behind" if not any(ahead) else "beside the pictures of"
        raise DatasetError(
            f"{where}: all points lie {side} all {len(views)} views (as {listed(blind)}): {AXES}, and that points and "
            "poses are of one world"
        )
    if blind:
        note(
            f"{where}: {len(blind)} of {len(views)} views see none of the points: {listed(blind)}; "
            + (AXES if 2 * len(blind) > len(views) else "check their poses")
        )
