"""The toy scenes as code: which surfaces stand where, what they are painted with, and where the cameras go round.

World units are metres, z is up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import textures as tex
from .color import to_linear
from .shapes import Cone, Disc, Rectangle, Shape, Sphere, Torus, box
from .sky import panorama
from .world import Part

Array = NDArray[np.floating[Any]]

Vector = tuple[float, float, float]

HALF, HEIGHT = 3.0, 3.0  # the room: 6 × 6 on the floor, 3 high
OVERLAP = 0.02  # walls run into each other, so that no ray slips through a seam
WINDOW = (1.7, 0.8, 4.3, 2.2)  # left, top, right, bottom on its wall


@dataclass(frozen=True)
class Orbit:
    """A closed path of cameras around `target`, rising and falling, nearing and parting."""

    target: tuple[float, float, float]
    radius: float
    radius_swing: float
    height: float
    height_swing: float
    field_of_view_degrees: float  # horizontal


@dataclass(frozen=True)
class Description:
    """All there is to know of a toy scene."""

    parts: list[Part]
    sky: Array  # [H, W, 3] linear radiance
    orbit: Orbit
    far_points: int  # of the sky, in the point cloud


def chrome_room(rng: np.random.Generator) -> Description:
    """Chrome, gold and lacquer among toys in a vividly patterned room: sharp reflections of what is near."""
    return _room(rng, shiny=True)


def diffuse_room(rng: np.random.Generator) -> Description:
    """The same room and the same shapes, painted: nothing reflects."""
    return _room(rng, shiny=False)


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
        Part(Cone((0, 0, z - 1.2), 0.75, edge, 1.2), to_linear(plinth)),
    ]
    return Description(parts, panorama(rng), Orbit((0, 0, -0.15), 3.3, 0.3, 0.75, 0.75, 52), far_points=900)


SCENES: dict[str, Callable[[np.random.Generator], Description]] = {
    "chrome_room": chrome_room,
    "sky_ball": sky_ball,
    "diffuse_room": diffuse_room,
}


def _room(rng: np.random.Generator, shiny: bool) -> Description:
    parts = [*_walls(rng), *_toys(rng), *_centrepiece(rng, shiny)]
    return Description(parts, panorama(rng), Orbit((0, 0, 0.85), 2.15, 0.15, 1.4, 0.4, 68), far_points=12)


def _walls(rng: np.random.Generator) -> list[Part]:
    """Floor, ceiling with lamps, and four walls, one with a window."""
    side, w, h = 2 * HALF, HALF + OVERLAP, HEIGHT
    x, y = tex.grid(side, side)
    floor = tex.weathered(tex.tiles(x, y, 1.0, rng), rng)
    ceiling = tex.weathered(tex.checker(x, y, 1.0, ((0.93, 0.92, 0.88), (0.80, 0.84, 0.86))), rng, 0.05)
    x, y = tex.grid(side, HEIGHT)
    walls = [_poster_wall(x, y, rng), tex.bookshelf(x, y, 0.6, rng), _window_wall(x, y, rng), _wave_wall(x, y, rng)]
    north, east, south, west = (tex.weathered(wall, rng) for wall in walls)
    wide = 2 * w
    parts = [
        _painted(Rectangle((-w, w, 0), (wide, 0, 0), (0, -wide, 0)), floor),
        _painted(Rectangle((-w, -w, h), (wide, 0, 0), (0, wide, 0)), ceiling),
        _painted(Rectangle((-w, HALF, h + OVERLAP), (wide, 0, 0), (0, 0, -h - 2 * OVERLAP)), north),
        _painted(Rectangle((HALF, w, h + OVERLAP), (0, -wide, 0), (0, 0, -h - 2 * OVERLAP)), east),
        _painted(Rectangle((-HALF, -w, h + OVERLAP), (0, wide, 0), (0, 0, -h - 2 * OVERLAP)), west),
    ]
    parts += _with_window((HALF, -HALF, h), (-side, 0, 0), (0, 0, -h), south)
    for lamp_x in (-1.4, 1.4):
        for lamp_y in (-1.4, 1.4):
            lamp = Rectangle((lamp_x - 0.6, lamp_y - 0.6, h - 0.03), (1.2, 0, 0), (0, 1.2, 0))
            parts.append(Part(lamp, to_linear(np.full((8, 8, 3), (1.0, 0.96, 0.88))), emission=6.0))
    return parts


def _poster_wall(x: Array, y: Array, rng: np.random.Generator) -> Array:
    """Mustard wallpaper in fine stripes, with three posters."""
    wall = tex.stripes(x, y, 0, 0.6, (tex.MUSTARD, (0.98, 0.80, 0.38), tex.MUSTARD, tex.CREAM))
    px, py = tex.grid(1.5, 1.9)
    burst = tex.sunburst(px, py, (0.75, 1.1), 20, (tex.VERMILION, tex.CREAM))
    tex.paint(burst, np.hypot(px - 0.75, py - 1.1) < 0.3, tex.INK)
    tex.paint(burst, np.hypot(px - 0.75, py - 1.1) < 0.22, tex.MUSTARD)
    text = tex.glyphs(px, py, 0.35, (tex.INK, tex.INK, tex.VERMILION), tex.CREAM, rng)
    targets = tex.rings(px, py, (0.75, 0.8), 0.16, (tex.TEAL, tex.CREAM, tex.SKY, tex.INK))
    for left, poster in ((0.35, burst), (2.25, text), (4.15, targets)):
        tex.hang(wall, tex.framed(poster, tex.INK), left, 0.45)
    wall[y > 2.75] = tex.INK
    return wall


def _wave_wall(x: Array, y: Array, rng: np.random.Generator) -> Array:
    """Wavy bands of colour under a line of writing."""
    colors = (tex.PLUM, tex.VERMILION, tex.CREAM, tex.MUSTARD, tex.GREEN, tex.INK, tex.SKY)
    height = y + 0.22 * np.sin(2 * np.pi * x / 2.0) + 0.06 * np.sin(2 * np.pi * x / 0.66)
    wall = tex.stripes(x, height, 90, 2.4, colors)
    band = tex.glyphs(x, y - 1.12, 0.6, (tex.CREAM, tex.MUSTARD), tex.INK, rng)
    inside = (y > 1.12) & (y < 1.87)
    wall[inside] = band[inside]
    return wall


def _window_wall(x: Array, y: Array, rng: np.random.Generator) -> Array:
    """Harlequin wallpaper, boards below, a white frame around the window."""
    wall = tex.harlequin(x, y, 0.6, 1.0, (tex.TEAL, (0.07, 0.52, 0.55), tex.CREAM))
    boards = y > 2.4
    wall[boards] = tex.planks(y, x, 0.2, rng)[boards]
    left, top, right, bottom = WINDOW
    frame = (x > left - 0.12) & (x < right + 0.12) & (y > top - 0.12) & (y < bottom + 0.12)
    wall[frame] = (0.97, 0.97, 0.95)
    return wall


def _with_window(corner: Vector, across: Vector, down: Vector, wall: Array) -> list[Part]:
    """The four rectangles around the window's opening, each with its piece of the wall's picture, and a mullion."""
    left, top, right, bottom = WINDOW
    width, height = float(np.linalg.norm(across)), float(np.linalg.norm(down))
    x_axis, y_axis = np.array(across) / width, np.array(down) / height

    def piece(x0: float, y0: float, x1: float, y1: float) -> Part:
        start = np.array(corner) + x0 * x_axis + y0 * y_axis
        rows = slice(round(y0 * tex.PER_METRE), round(y1 * tex.PER_METRE))
        columns = slice(round(x0 * tex.PER_METRE), round(x1 * tex.PER_METRE))
        edges = (tuple(edge.tolist()) for edge in ((x1 - x0) * x_axis, (y1 - y0) * y_axis))
        return _painted(Rectangle(tuple(start.tolist()), *edges), wall[rows, columns])

    middle = (left + right) / 2
    return [
        piece(0, 0, width, top),
        piece(0, bottom, width, height),
        piece(0, top, left, bottom),
        piece(right, top, width, bottom),
        piece(middle - 0.04, top, middle + 0.04, bottom),
    ]


def _toys(rng: np.random.Generator) -> list[Part]:
    """Lettered blocks around the middle of the floor, close enough to fill the mirrors."""
    parts = []
    blocks = (
        (1.30, 20, 0.42, (tex.VERMILION, tex.CREAM)),
        (1.20, 70, 0.34, (tex.CREAM, tex.TEAL)),
        (1.25, 120, 0.50, (tex.MUSTARD, tex.INK)),
        (1.20, 200, 0.36, (tex.SKY, tex.CREAM)),
        (1.30, 240, 0.46, (tex.CREAM, tex.PLUM)),
        (1.20, 310, 0.38, (tex.GREEN, tex.CREAM)),
    )
    for distance, bearing_degrees, size, (paper, ink) in blocks:
        bearing = np.radians(bearing_degrees)
        base = (distance * np.cos(bearing), distance * np.sin(bearing), 0.0)
        for face in box(base, (size, size, size), bearing_degrees + 25):
            x, y = tex.grid(size, size)
            letter = tex.glyphs(x, 1.25 * y, 1.001 * size, (ink,), paper, rng)
            parts.append(_painted(face, tex.weathered(tex.framed(letter, ink, 0.05 * size), rng)))
    return parts


def _centrepiece(rng: np.random.Generator, shiny: bool) -> list[Part]:
    """A ball on a striped drum, a small ball on each side, and a lacquered ring around the drum's foot."""
    x, y = tex.grid(2 * np.pi * 0.5, 0.5)
    drum = tex.stripes(x, y, 60, 2 * np.pi * 0.5 / 6, (tex.INK, tex.CREAM, tex.VERMILION, tex.CREAM))
    x, y = tex.grid(2 * np.pi * 0.5, 0.5)
    parts = [
        _painted(Cone((0, 0, 0), 0.5, 0.4, 0.5), tex.weathered(drum, rng)),
        _painted(Disc((0, 0, 0.5), 0.4), tex.weathered(tex.plain(x, tex.CREAM), rng)),
    ]
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
            parts.append(_painted(shape, tex.weathered(tex.harlequin(x, y, cell, 1.5 * cell, palette), rng)))
    return parts


def _painted(shape: Shape, picture: Array) -> Part:
    return Part(shape, to_linear(picture))
