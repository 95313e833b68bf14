"""`glass`: clear solids, whose color is refracted rather than reflected."""

from __future__ import annotations

import numpy as np

from .. import textures as tex
from ..shapes import Rectangle, Shape, Sphere, box
from ..sky import panorama
from ..world import Part
from .description import Description, Orbit
from .room import Block, blocks, drum, walls

CROWN = 1.5  # index of refraction of window glass
NO_PICTURE = np.zeros((1, 1, 3))
BLOCKS: tuple[Block, ...] = (
    (0.95, 5, 0.40, (tex.VERMILION, tex.CREAM)),
    (0.95, 62, 0.36, (tex.CREAM, tex.TEAL)),
    (0.92, 125, 0.44, (tex.MUSTARD, tex.INK)),
    (0.95, 185, 0.36, (tex.SKY, tex.CREAM)),
    (0.98, 245, 0.42, (tex.CREAM, tex.PLUM)),
    (0.95, 300, 0.36, (tex.GREEN, tex.CREAM)),
)


def glass(rng: np.random.Generator) -> Description:
    """A glass ball, a glass brick and two panes among toys: what is seen through them bends and is doubled."""
    parts = [*walls(rng), *blocks(BLOCKS, rng), *drum(rng)]
    shapes: list[Shape] = [Sphere((0, 0, 1.13), 0.62)]
    for bearing_degrees, width, height in ((30, 1.5, 1.15), (215, 1.2, 0.95)):
        shapes += _solid(_around(1.38, bearing_degrees, 0.005), (0.06, width, height), bearing_degrees)
    shapes += _solid(_around(1.3, 120, 0.005), (0.5, 0.36, 0.7), 150)
    shapes += _solid(_around(1.3, 300, 0.005), (0.34, 0.34, 0.5), 325)
    parts += [Part(shape, NO_PICTURE, ior=CROWN) for shape in shapes]
    return Description(parts, panorama(rng), Orbit((0, 0, 0.8), 2.4, 0.12, 1.35, 0.35, 64), far_points=12, bounces=64)


def _around(distance: float, bearing_degrees: float, height: float) -> tuple[float, float, float]:
    bearing = np.radians(bearing_degrees)
    return float(distance * np.cos(bearing)), float(distance * np.sin(bearing)), height


def _solid(base: tuple[float, float, float], size: tuple[float, float, float], turn_degrees: float) -> list[Rectangle]:
    """A closed box: `shapes.box` and its bottom."""
    *sides, top = box(base, size, turn_degrees)
    corner = tuple((np.array(top.corner) + np.array(top.down) - (0, 0, size[2])).tolist())
    return [*sides, top, Rectangle(corner, top.across, tuple((-np.array(top.down)).tolist()))]
