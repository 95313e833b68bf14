"""`chrome_room`, sharp reflections of what is near, and `diffuse_room`, the same shapes without any."""

from __future__ import annotations

import numpy as np

from ...formats.srgb import to_linear
from .. import textures as tex
from ..shapes import Shape, Sphere, Torus
from ..sky import panorama
from ..world import Part
from .description import Description, Orbit, painted
from .room import BLOCKS, blocks, drum, walls


def chrome_room(rng: np.random.Generator) -> Description:
    """Chrome, gold and lacquer among toys in a vividly patterned room: sharp reflections of what is near."""
    return _room(rng, shiny=True)


def diffuse_room(rng: np.random.Generator) -> Description:
    """The same room and the same shapes, painted: nothing reflects."""
    return _room(rng, shiny=False)


def _room(rng: np.random.Generator, shiny: bool) -> Description:
    parts = [*walls(rng), *blocks(BLOCKS, rng), *drum(rng), *_balls_and_ring(rng, shiny)]
    return Description(parts, panorama(rng), Orbit((0, 0, 0.85), 2.15, 0.15, 1.4, 0.4, 68), far_points=12)


def _balls_and_ring(rng: np.random.Generator, shiny: bool) -> list[Part]:
    """A ball on the drum, a small ball on each side, and a lacquered ring around the drum's foot."""
    parts = []
    reflectors: list[tuple[Shape, tex.Color, float, float, tuple[tex.Color, ...]]] = [
        (Sphere((0, 0, 1.16), 0.7), (0.30, 0.31, 0.34), 0.88, 0.0, (tex.TEAL, tex.CREAM, tex.MUSTARD)),
        (Sphere((0.16, -1.12, 0.32), 0.32), (0.80, 0.56, 0.16), 0.6, 0.0, (tex.VERMILION, tex.CREAM, tex.INK)),
        (Sphere((-1.05, 0.38, 0.30), 0.30), (0.30, 0.31, 0.34), 0.85, 0.0, (tex.PLUM, tex.MUSTARD, tex.CREAM)),
        (Torus((0, 0, 0.12), 0.66, 0.12), (0.70, 0.08, 0.10), 0.3, 0.25, (tex.GREEN, tex.CREAM, tex.INK)),
    ]
    for shape, color, reflectance, roughness, palette in reflectors:
        x, y = tex.grid(*shape.extent)
        if shiny:
            albedo = tex.weathered(tex.plain(x, color), rng)
            parts.append(Part(shape, to_linear(albedo), reflectance, roughness))
        else:
            cell = shape.extent[0] / 12
            parts.append(painted(shape, tex.weathered(tex.harlequin(x, y, cell, 1.5 * cell, palette), rng)))
    return parts
