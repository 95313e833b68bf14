"""Where direct labels go: beside their marks, over no mark, no whisker and no other label."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

MAX_COVERED = 0.1  # the share of its area that a label which can be left out may cover at most


@dataclass(frozen=True)
class Box:
    """An axis-aligned rectangle in pixels."""

    left: float
    bottom: float
    right: float
    top: float

    def overlap(self, other: Box) -> float:
        """The shared area, square pixels."""
        width = min(self.right, other.right) - max(self.left, other.left)
        height = min(self.top, other.top) - max(self.bottom, other.bottom)
        return max(width, 0) * max(height, 0)

    def outside(self, frame: Box) -> float:
        """The area that sticks out of `frame`, square pixels."""
        return (self.right - self.left) * (self.top - self.bottom) - self.overlap(frame)


def around(x: float, y: float, reach: float) -> Box:
    return Box(x - reach, y - reach, x + reach, y + reach)


def place_labels(
    marks: Sequence[tuple[float, float]],
    sizes: Sequence[tuple[float, float]],
    needed: Sequence[bool],
    frame: Box,
    obstacles: Sequence[Box] = (),
    gap: float = 9,
) -> list[Box | None]:
    """A box for each mark's label, chosen one after the other for the least overlap, then the nearest.

    Args:
        marks: centers, pixels.
        sizes: width and height of each label, pixels.
        needed: False for labels to leave out (None) rather than to cover another label or mark.
        frame: labels stay within.
        obstacles: what labels should not cover, besides the marks.
    """
    taken = [around(x, y, gap * 0.8) for x, y in marks] + list(obstacles)
    boxes: list[Box | None] = []

    def harm(box: Box) -> float:
        return sum(box.overlap(other) for other in taken) + 10 * box.outside(frame)

    for (x, y), (width, height), must in zip(marks, sizes, needed, strict=True):
        best = min(_candidates(x, y, width, height, gap), key=lambda item: item[0] + harm(item[1]))[1]
        if must or harm(best) < MAX_COVERED * width * height:
            boxes.append(best)
            taken.append(best)
        else:
            boxes.append(None)
    return boxes


def along(corners: Sequence[tuple[float, float]], step: float = 6) -> list[Box]:
    """Small boxes along a line through `corners`, pixels: an obstacle to labels."""
    boxes = []
    for (x0, y0), (x1, y1) in pairwise(corners):
        count = max(2, int(np.hypot(x1 - x0, y1 - y0) / step))
        boxes += [
            around(float(x), float(y), 1.5)
            for x, y in zip(np.linspace(x0, x1, count), np.linspace(y0, y1, count), strict=True)
        ]
    return boxes


def _candidates(x: float, y: float, width: float, height: float, gap: float) -> list[tuple[float, Box]]:
    """(cost, box): right first, then left, above and below, corners, and the same farther out."""
    found = []
    for ring, distance in enumerate((gap, 2 * gap, 3.5 * gap)):
        places = [
            (x + distance, y - height / 2),
            (x - distance - width, y - height / 2),
            (x - width / 2, y + distance),
            (x - width / 2, y - distance - height),
            (x + distance * 0.6, y + distance * 0.6),
            (x - distance * 0.6 - width, y + distance * 0.6),
            (x + distance * 0.6, y - distance * 0.6 - height),
            (x - distance * 0.6 - width, y - distance * 0.6 - height),
        ]
        for turn, (left, bottom) in enumerate(places):
            found.append((30.0 * ring + turn, Box(left, bottom, left + width, bottom + height)))
    return found
