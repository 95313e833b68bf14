"""`facing_mirrors`: mirrors that show each other."""

from __future__ import annotations

import numpy as np

from ...formats.srgb import to_linear
from .. import textures as tex
from ..lathe import Lathe
from ..shapes import Rectangle, Sphere, box
from ..sky import panorama
from ..world import Part
from .description import Description, Orbit, painted
from .room import BLOCKS, HALF, blocks, walls

WIDTH, BOTTOM, TOP = 5.6, 0.12, 2.85
WALL_GAP = 0.06  # from the wall


def facing_mirrors(rng: np.random.Generator) -> Description:
    """Two mirrors on opposite walls: rooms within rooms, each further and dimmer, and toys seen from both sides."""
    parts = [*walls(rng), *blocks(BLOCKS, rng), *_figure(rng)]
    for side, frame in ((1, tex.VERMILION), (-1, tex.TEAL)):
        parts += _mirror(side, frame, rng)
    return Description(parts, panorama(rng), Orbit((0, 0, 0.9), 2.15, 0.15, 1.35, 0.3, 70), far_points=12, bounces=24)


def _mirror(side: int, frame: tex.Color, rng: np.random.Generator) -> list[Part]:
    """A framed mirror along x, on the wall at y = ±HALF."""
    y = side * (HALF - WALL_GAP)
    glass = Rectangle((-side * WIDTH / 2, y, TOP), (side * WIDTH, 0, 0), (0, 0, BOTTOM - TOP))
    parts = [Part(glass, to_linear(tex.plain(tex.grid(1, 1)[0], tex.SLATE)), reflectance=0.92)]
    bar, depth = 0.09, 0.06
    middle = (TOP + BOTTOM) / 2
    for x, z, size in (
        (0, TOP, (WIDTH + 2 * bar, depth, bar)),
        (0, BOTTOM - bar, (WIDTH + 2 * bar, depth, bar)),
        (-(WIDTH + bar) / 2, BOTTOM, (bar, depth, 2 * (middle - BOTTOM))),
        ((WIDTH + bar) / 2, BOTTOM, (bar, depth, 2 * (middle - BOTTOM))),
    ):
        for face in box((x, y, z), size, 0):
            u, v = tex.grid(*face.extent)
            parts.append(painted(face, tex.weathered(tex.stripes(u, v, 45, 0.3, (frame, tex.CREAM)), rng)))
    return parts


def _figure(rng: np.random.Generator) -> list[Part]:
    """A bowling pin whose two sides differ, so that every image in the tunnel shows which way it is turned."""
    body = Lathe((0, 0, 0), ((0.06, 0.74), (0.11, 0.6), (0.28, 0.3), (0.24, 0.08), (0.17, 0.0)))
    x, y = tex.grid(*body.extent)
    half = body.extent[0] / 2
    front = tex.harlequin(x, y, half / 5, 0.22, (tex.MUSTARD, tex.INK, tex.CREAM))
    back = tex.stripes(x, y, 90, 0.18, (tex.SKY, tex.CREAM, tex.PLUM))
    coat = np.where((x < half)[..., None], front, back)
    head = Sphere((0, 0, 0.94), 0.24)
    x, y = tex.grid(*head.extent)
    face = np.where((x < head.extent[0] / 2)[..., None], tex.checker(x, y, 0.12, (tex.CREAM, tex.VERMILION)), tex.GREEN)
    return [painted(body, tex.weathered(coat, rng)), painted(head, tex.weathered(face, rng))]
