"""`sky_ball`: a mirror that sees nothing but distant light."""

from __future__ import annotations

import numpy as np

from ...formats.srgb import to_linear
from .. import textures as tex
from ..shapes import Cone, Sphere
from ..sky import panorama
from ..world import Part
from .description import Description, Orbit, painted


def sky_ball(rng: np.random.Generator) -> Description:
    """A chrome ball on a narrower plinth high above far fields: its mirror sees distant light and nothing else."""
    x, y = tex.grid(2 * np.pi * 0.9, 1.2)
    plinth = tex.weathered(tex.harlequin(x, y, 2 * np.pi * 0.9 / 12, 0.3, (tex.CREAM, tex.VERMILION, tex.INK)), rng)
    plinth[y < 0.1] = tex.MUSTARD
    x, y = tex.grid(2 * np.pi * 0.9, 0.9)
    ball = Sphere((0, 0, 0), 1.0, top=0.625)  # down to the plinth's edge: sin(112.5°) = 0.924
    z = np.cos(np.pi * 0.625)
    edge = np.sin(np.pi * 0.625)
    parts = [
        Part(ball, to_linear(tex.plain(x, tex.SLATE)), reflectance=0.9),
        painted(Cone((0, 0, z - 1.2), 0.75, edge, 1.2), plinth),
    ]
    return Description(parts, panorama(rng), Orbit((0, 0, -0.15), 3.3, 0.3, 0.75, 0.75, 52), far_points=900)
