"""Colors: whether pictures show points in the colors that these have, as they lie or when they are turned."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from envgs_bench.core import View

from ..notes import note

MOST_VIEWS, MOST_POINTS = 24, 2000  # that are looked at, evenly chosen
LEAST_POINTS, LEAST_VIEWS = 12, 8  # a view's, and how many views have so many, to speak of them
VARIED = 0.03  # least standard deviation of the points' colors
UNLIKE = 0.15  # correlation below which pictures say nothing of the points
BETTER, LIKE = 0.25, 0.35  # by how much a turned picture's must be higher, and how high

Turn = Callable[[NDArray, NDArray], tuple[NDArray, NDArray]]
TURNS: dict[str, Turn] = {  # places in shares of the edges
    "mirrored from left to right": lambda x, y: (1 - x, y),
    "upside down and mirrored": lambda x, y: (x, 1 - y),
    "turned by 180°": lambda x, y: (1 - x, 1 - y),
    "half as large": lambda x, y: (x / 2, y / 2),
    "twice as large": lambda x, y: (2 * x, 2 * y),
}


def check_colors(where: str, views: Sequence[View], points: Tensor, colors: Tensor) -> None:
    """Note pictures that do not show the points' colors where their cameras see these.

    Points behind others are shown in another color, and shiny ones in many: most are not. Clouds of one color, as
    random ones, say nothing.
    """
    if len(points) < LEAST_POINTS or float(colors.std(dim=0).max()) < VARIED:
        return
    chosen = slice(None, None, max(1, len(points) // MOST_POINTS))
    places, shades = points[chosen].cpu().numpy(), colors[chosen].cpu().numpy()
    some = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, MOST_VIEWS).astype(int))]
    found = [found for view in some if (found := _correlations(view, places, shades)) is not None]
    if len(found) < LEAST_VIEWS:
        return
    as_is, *turned = np.median(found, axis=0)
    best = int(np.argmax(turned))
    if turned[best] > max(LIKE, as_is + BETTER):
        note(
            f"{where}: the pictures show the points' colors where these are if the pictures are {list(TURNS)[best]} "
            f"(correlation {turned[best]:.2f}, as they are {as_is:.2f}): check images, axes and sizes"
        )
    elif as_is < UNLIKE:
        note(
            f"{where}: the pictures do not show the points' colors where their cameras see these (correlation "
            f"{as_is:.2f}): images, poses, intrinsics and points may not belong together; check which image is "
            "which, the poses' axes and the size that the intrinsics hold for"
        )


def _correlations(view: View, points: NDArray, colors: NDArray) -> NDArray | None:
    """Of the points' colors and the picture's, as it is and by each of TURNS; None where too few are seen."""
    camera = view.camera
    pose, k = camera.world_to_camera.cpu().numpy(), camera.intrinsics.cpu().numpy()
    inside = points @ pose[:3, :3].T + pose[:3, 3]
    ahead = inside[:, 2] > 0
    x, y = ((inside[ahead] @ k.T)[:, :2] / inside[ahead, 2:] / [camera.width, camera.height]).T
    shades, picture = colors[ahead], view.image.cpu().numpy()
    places = [(x, y), *(turn(x, y) for turn in TURNS.values())]
    found = [_correlation(picture, shades, *place) for place in places]
    return None if found[0] is None else np.array([0.0 if value is None else value for value in found])


def _correlation(picture: NDArray, colors: NDArray, x: NDArray, y: NDArray) -> float | None:
    height, width = picture.shape[:2]
    shown = (x >= 0) & (x < 1) & (y >= 0) & (y < 1)
    if np.count_nonzero(shown) < LEAST_POINTS:
        return None
    there = picture[(y[shown] * height).astype(np.int64), (x[shown] * width).astype(np.int64)]
    theirs, own = there - there.mean(axis=0), colors[shown] - colors[shown].mean(axis=0)
    size = np.linalg.norm(theirs) * np.linalg.norm(own)
    return float((theirs * own).sum() / size) if size else None
