"""`thin_rails`: structures a pixel wide before mirrors, seen twice."""

from __future__ import annotations

import numpy as np

from ...formats.srgb import to_linear
from .. import textures as tex
from ..rod import Rod
from ..shapes import Sphere, box
from ..sky import panorama
from ..world import Part
from .description import Array, Description, Orbit, painted
from .room import walls

SIDE, FOOT, TOP = 1.05, 0.1, 1.35
TURN = 45  # degrees
FENCE_DISTANCE, RAIL_HEIGHT = 0.92, 0.74  # from the middle to each side of the fence; height of its upper rail
BARS = ((0.022, tex.MUSTARD), (0.010, tex.VERMILION), (0.014, tex.INK), (0.010, tex.CREAM))  # radius, color; in turn


def thin_rails(rng: np.random.Generator) -> Description:
    """A mirrored pillar behind a fence of bars and wires one to four centimeters thick, with balls on the floor."""
    parts = [*walls(rng), *_pillar(rng), *_fence(rng), *_balls(rng)]
    return Description(parts, panorama(rng), Orbit((0, 0, 0.72), 2.25, 0.1, 1.25, 0.3, 64), far_points=12)


def _pillar(rng: np.random.Generator) -> list[Part]:
    parts = []
    for base, height, width in ((0.0, FOOT, SIDE + 0.1), (TOP, 0.1, SIDE + 0.06)):
        for face in box((0, 0, base), (width, width, height), TURN):
            x, y = tex.grid(*face.extent)
            parts.append(painted(face, tex.weathered(tex.checker(x, y, 0.14, (tex.TEAL, tex.CREAM)), rng)))
    for face in box((0, 0, FOOT), (SIDE, SIDE, TOP - FOOT), TURN)[:4]:
        parts.append(Part(face, to_linear(tex.plain(tex.grid(1, 1)[0], tex.SLATE)), reflectance=0.9))
    return parts


def _fence(rng: np.random.Generator) -> list[Part]:
    """Upright bars of several widths between two rails, and a pair of crossed wires a side."""
    parts = []
    for quarter in range(4):
        turn = np.radians(TURN + 90 * quarter)
        inward, along = np.array([-np.sin(turn), np.cos(turn), 0]), np.array([np.cos(turn), np.sin(turn), 0])

        def place(position: float, height: float, inward: Array = inward, along: Array = along) -> Array:
            return -FENCE_DISTANCE * inward + position * FENCE_DISTANCE * along + np.array([0, 0, height])

        for position, (radius, color) in zip(np.arange(-1, 1, 0.25), 2 * BARS, strict=True):
            parts.append(_rod(place(position, 0), place(position, RAIL_HEIGHT + 0.03), radius, color, rng))
        for height in (0.08, RAIL_HEIGHT):
            parts.append(_rod(place(-1, height), place(1, height), 0.02, tex.VERMILION, rng))
        parts.append(_rod(place(-1, 0.08), place(1, RAIL_HEIGHT), 0.006, tex.SKY, rng))
        parts.append(_rod(place(-1, RAIL_HEIGHT), place(1, 0.08), 0.006, tex.SKY, rng))
    return parts


def _rod(start: Array, end: Array, radius: float, color: tex.Color, rng: np.random.Generator) -> Part:
    """A bar with rings of a darker shade, which give it something to match along its length."""
    rod = Rod(tuple(start.tolist()), tuple(end.tolist()), radius)
    x, y = tex.grid(*rod.extent)
    dark = (0.45 * color[0], 0.45 * color[1], 0.45 * color[2])
    return painted(rod, tex.weathered(tex.stripes(x, y, 90, 0.16, (color, color, color, dark)), rng))


def _balls(rng: np.random.Generator) -> list[Part]:
    """Painted balls between fence and mirror."""
    parts = []
    for bearing_degrees, radius, palette in (
        (15, 0.13, (tex.VERMILION, tex.CREAM, tex.INK)),
        (75, 0.10, (tex.SKY, tex.CREAM, tex.PLUM)),
        (160, 0.12, (tex.MUSTARD, tex.INK, tex.CREAM)),
        (250, 0.13, (tex.GREEN, tex.CREAM, tex.VERMILION)),
        (290, 0.09, (tex.PLUM, tex.MUSTARD, tex.CREAM)),
    ):
        bearing = np.radians(bearing_degrees)
        ball = Sphere((0.8 * np.cos(bearing), 0.8 * np.sin(bearing), radius), radius)
        x, y = tex.grid(*ball.extent)
        parts.append(painted(ball, tex.weathered(tex.harlequin(x, y, ball.extent[0] / 6, radius, palette), rng)))
    return parts
