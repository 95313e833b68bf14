"""`brushed_patio`: a walled court under open sky, with a varnished floor, brushed metal and a mirror on its wall."""

from __future__ import annotations

import numpy as np

from .. import textures as tex
from ..lathe import Lathe
from ..rod import Rod
from ..shapes import Disc, Rectangle, Sphere, Torus, box
from ..sky import afternoon
from ..world import Part
from .description import Description, Orbit, metallic, painted
from .room import BLOCKS, HALF, blocks, open_walls

HEIGHT = 0.55  # of the counter


def brushed_patio(rng: np.random.Generator) -> Description:
    """Reflections that are blurred: in metals brushed more and less finely, and in a floor under worn varnish."""
    floor, *others = open_walls(rng)
    varnished = Part(floor.shape, floor.albedo, coat=1.5, roughness=0.25)
    parts = [varnished, *others, *blocks(BLOCKS, rng), *_counter(rng), *_vessels(), *_mirror(rng)]
    return Description(parts, 1.7 * afternoon(rng), Orbit((0, 0, 0.8), 2.1, 0.15, 1.45, 0.35, 66), far_points=100)


def _counter(rng: np.random.Generator) -> list[Part]:
    """A tiled block with a coarsely brushed top."""
    *sides, top = box((0, 0, 0), (1.1, 0.8, HEIGHT), 30)
    parts = [metallic(top, "Cr", roughness=0.35)]
    for side in sides:
        x, y = tex.grid(*side.extent)
        parts.append(painted(side, tex.weathered(tex.framed(tex.tiles(x, y, 0.275, rng), tex.INK, 0.03), rng)))
    return parts


def _vessels() -> list[Part]:
    """A chrome carafe with a golden rim, a finely brushed can and a golden ball."""
    body = ((0.0, 0.46), (0.06, 0.455), (0.10, 0.40), (0.24, 0.26), (0.27, 0.12), (0.24, 0.02), (0.20, 0.0))
    return [
        metallic(Lathe((0.2, 0.02, HEIGHT), body), "Cr"),
        metallic(Torus((0.2, 0.02, HEIGHT + 0.46), 0.09, 0.025), "Au", roughness=0.2),
        metallic(Rod((-0.28, 0.18, HEIGHT), (-0.28, 0.18, HEIGHT + 0.45), 0.13), "Al", roughness=0.3),
        metallic(Disc((-0.28, 0.18, HEIGHT + 0.45), 0.13), "Al", roughness=0.3),
        metallic(Sphere((-0.22, -0.22, HEIGHT + 0.13), 0.13), "Au"),
    ]


def _mirror(rng: np.random.Generator) -> list[Part]:
    """A framed mirror on the wall at +y."""
    x, y = tex.grid(2.1, 1.6)
    frame = tex.weathered(tex.checker(x, y, 0.1, (tex.INK, tex.CREAM)), rng)
    return [
        painted(Rectangle((-1.05, HALF - 0.05, 1.9), (2.1, 0, 0), (0, 0, -1.6)), frame),
        metallic(Rectangle((-0.95, HALF - 0.07, 1.8), (1.9, 0, 0), (0, 0, -1.4)), "Ag"),
    ]
