"""`copper_table`: a glazed table outdoors with chrome, copper and painted things, in all the light there is."""

from __future__ import annotations

import numpy as np

from ...formats.srgb import to_linear
from .. import textures as tex
from ..lathe import Lathe
from ..shapes import Rectangle, Shape, Sphere, Torus, box
from ..sky import afternoon
from ..world import Part
from .description import Array, Description, Orbit, metallic, painted

TOP = 0.6  # of the table, above the ground
GLAZE = 1.5  # index of refraction
GROUND = 5.0  # from the middle to its edge


def copper_table(rng: np.random.Generator) -> Description:
    """Half of a picture is glaze over a painted table, a tenth chrome and copper; the rest is diffuse."""
    parts = [*_ground(rng), *_table(rng), *_metal(), *_painted_things(rng)]
    return Description(parts, afternoon(rng), Orbit((0, 0, TOP + 0.1), 2.3, 0.25, 1.7, 0.4, 50), far_points=300)


def _ground(rng: np.random.Generator) -> list[Part]:
    side = 2 * GROUND
    x, y = tex.grid(side, side)
    picture = tex.weathered(tex.planks(x, y, 0.4, rng), rng)
    band = (np.hypot(x - GROUND, y - GROUND) > 1.9) & (np.hypot(x - GROUND, y - GROUND) < 2.2)
    tex.paint(picture, band, tex.choose((x / 0.2).astype(int) + (y / 0.2).astype(int), (tex.CREAM, tex.TEAL))[band])
    return [painted(Rectangle((-GROUND, GROUND, 0), (side, 0, 0), (0, -side, 0)), picture)]


def _table(rng: np.random.Generator) -> list[Part]:
    """A slab with a glazed top of painted squares, its sides glazed too."""
    parts = []
    for face in box((0, 0, 0), (2.0, 2.0, TOP), 20):
        x, y = tex.grid(*face.extent)
        squares = tex.checker(x, y, 0.25, ((0.74, 0.62, 0.48), (0.30, 0.24, 0.30)))
        petals = np.hypot((x % 0.5) - 0.25, (y % 0.5) - 0.25)
        tex.paint(squares, (petals > 0.13) & (petals < 0.18), tex.VERMILION)
        tex.paint(squares, petals < 0.06, tex.MUSTARD)
        parts.append(_glazed(face, tex.weathered(squares, rng)))
    return parts


def _metal() -> list[Part]:
    """A chrome ball, a copper pot with a lightly brushed belly, a chrome ring that leans on nothing."""
    pot = ((0.0, 0.30), (0.05, 0.295), (0.13, 0.29), (0.20, 0.20), (0.21, 0.12), (0.15, 0.02), (0.12, 0.0))
    return [
        metallic(Sphere((0.1, 0.05, TOP + 0.34), 0.34), "Cr"),
        metallic(Lathe((-0.62, -0.30, TOP), pot), "Cu", roughness=0.2),
        metallic(Torus((0.55, -0.62, TOP + 0.055), 0.16, 0.055), "Cr"),
    ]


def _painted_things(rng: np.random.Generator) -> list[Part]:
    """Lettered blocks, a painted ball and a tile that stands on its edge, close enough to be mirrored."""
    parts = []
    for place, size, turn, ink, paper in (
        ((-0.35, 0.62), 0.26, 15, tex.VERMILION, tex.CREAM),
        ((0.72, 0.25), 0.22, 50, tex.INK, tex.MUSTARD),
        ((0.05, -0.66), 0.18, 75, tex.CREAM, tex.GREEN),
    ):
        for face in box((*place, TOP), (size, size, size), turn):
            x, y = tex.grid(*face.extent)
            letters = tex.glyphs(x, 1.25 * y, 0.5 * size, (ink,), paper, rng)
            parts.append(painted(face, tex.weathered(letters, rng)))
    ball = Sphere((0.45, 0.72, TOP + 0.16), 0.16)
    x, y = tex.grid(*ball.extent)
    parts.append(painted(ball, tex.weathered(tex.harlequin(x, y, 0.17, 0.2, (tex.SKY, tex.CREAM, tex.INK)), rng)))
    for face in box((-0.75, 0.25, TOP), (0.42, 0.05, 0.45), 70):
        x, y = tex.grid(*face.extent)
        picture = tex.rings(x, y, (0.21, 0.22), 0.12, (tex.PLUM, tex.CREAM, tex.TEAL))
        parts.append(painted(face, tex.weathered(picture, rng)))
    return parts


def _glazed(shape: Shape, picture: Array) -> Part:
    return Part(shape, to_linear(picture), coat=GLAZE)
