"""The room that several toy scenes stand in: patterned walls, a window, lamps, lettered blocks."""

from __future__ import annotations

import numpy as np

from ...formats.srgb import to_linear
from .. import textures as tex
from ..shapes import Cone, Disc, Rectangle, box
from ..world import Part
from .description import Array, Vector, painted

HALF, HEIGHT = 3.0, 3.0  # the room: 6 × 6 on the floor, 3 high
OVERLAP = 0.02  # walls run into each other, so that no ray slips through a seam
WINDOW = (1.7, 0.8, 4.3, 2.2)  # left, top, right, bottom on its wall

# distance from the middle of the floor, bearing in degrees, size, (paper, ink)
Block = tuple[float, float, float, tuple[tex.Color, tex.Color]]
BLOCKS: tuple[Block, ...] = (
    (1.30, 20, 0.42, (tex.VERMILION, tex.CREAM)),
    (1.20, 70, 0.34, (tex.CREAM, tex.TEAL)),
    (1.25, 120, 0.50, (tex.MUSTARD, tex.INK)),
    (1.20, 200, 0.36, (tex.SKY, tex.CREAM)),
    (1.30, 240, 0.46, (tex.CREAM, tex.PLUM)),
    (1.20, 310, 0.38, (tex.GREEN, tex.CREAM)),
)


def walls(rng: np.random.Generator) -> list[Part]:
    """Floor, ceiling with lamps, and four walls, one with a window."""
    w, h = HALF + OVERLAP, HEIGHT
    floor = _floor(rng)
    x, y = tex.grid(2 * HALF, 2 * HALF)
    ceiling = tex.weathered(tex.checker(x, y, 1.0, ((0.93, 0.92, 0.88), (0.80, 0.84, 0.86))), rng, 0.05)
    parts = [floor, painted(Rectangle((-w, -w, h), (2 * w, 0, 0), (0, 2 * w, 0)), ceiling), *_four_walls(rng)]
    for lamp_x in (-1.4, 1.4):
        for lamp_y in (-1.4, 1.4):
            lamp = Rectangle((lamp_x - 0.6, lamp_y - 0.6, h - 0.03), (1.2, 0, 0), (0, 1.2, 0))
            parts.append(Part(lamp, to_linear(np.full((8, 8, 3), (1.0, 0.96, 0.88))), emission=6.0))
    return parts


def open_walls(rng: np.random.Generator) -> list[Part]:
    """The floor, and the four walls, under open sky."""
    return [_floor(rng), *_four_walls(rng)]


def _floor(rng: np.random.Generator) -> Part:
    w = HALF + OVERLAP
    x, y = tex.grid(2 * HALF, 2 * HALF)
    tiles = tex.weathered(tex.tiles(x, y, 1.0, rng), rng)
    return painted(Rectangle((-w, w, 0), (2 * w, 0, 0), (0, -2 * w, 0)), tiles)


def _four_walls(rng: np.random.Generator) -> list[Part]:
    """The walls, from the north on; in the south one a window."""
    side, w, h = 2 * HALF, HALF + OVERLAP, HEIGHT
    x, y = tex.grid(side, HEIGHT)
    walls = [_poster_wall(x, y, rng), tex.bookshelf(x, y, 0.6, rng), _window_wall(x, y, rng), _wave_wall(x, y, rng)]
    north, east, south, west = (tex.weathered(wall, rng) for wall in walls)
    wide = 2 * w
    return [
        painted(Rectangle((-w, HALF, h + OVERLAP), (wide, 0, 0), (0, 0, -h - 2 * OVERLAP)), north),
        painted(Rectangle((HALF, w, h + OVERLAP), (0, -wide, 0), (0, 0, -h - 2 * OVERLAP)), east),
        painted(Rectangle((-HALF, -w, h + OVERLAP), (0, wide, 0), (0, 0, -h - 2 * OVERLAP)), west),
        *_with_window((HALF, -HALF, h), (-side, 0, 0), (0, 0, -h), south),
    ]


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
    """Wavy bands of color under a line of writing."""
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
        rows = slice(round(y0 * tex.TEXELS_PER_METER), round(y1 * tex.TEXELS_PER_METER))
        columns = slice(round(x0 * tex.TEXELS_PER_METER), round(x1 * tex.TEXELS_PER_METER))
        edges = (tuple(edge.tolist()) for edge in ((x1 - x0) * x_axis, (y1 - y0) * y_axis))
        return painted(Rectangle(tuple(start.tolist()), *edges), wall[rows, columns])

    middle = (left + right) / 2
    return [
        piece(0, 0, width, top),
        piece(0, bottom, width, height),
        piece(0, top, left, bottom),
        piece(right, top, width, bottom),
        piece(middle - 0.04, top, middle + 0.04, bottom),
    ]


def blocks(which: tuple[Block, ...], rng: np.random.Generator) -> list[Part]:
    """Lettered blocks on the floor, close enough to the middle to fill the mirrors there."""
    parts = []
    for distance, bearing_degrees, size, (paper, ink) in which:
        bearing = np.radians(bearing_degrees)
        base = (distance * np.cos(bearing), distance * np.sin(bearing), 0.0)
        for face in box(base, (size, size, size), bearing_degrees + 25):
            x, y = tex.grid(size, size)
            letter = tex.glyphs(x, 1.25 * y, 1.001 * size, (ink,), paper, rng)
            parts.append(painted(face, tex.weathered(tex.framed(letter, ink, 0.05 * size), rng)))
    return parts


def drum(rng: np.random.Generator) -> list[Part]:
    """A striped plinth in the middle, half a meter high."""
    x, y = tex.grid(2 * np.pi * 0.5, 0.5)
    side = tex.stripes(x, y, 60, 2 * np.pi * 0.5 / 6, (tex.INK, tex.CREAM, tex.VERMILION, tex.CREAM))
    x, y = tex.grid(2 * np.pi * 0.5, 0.5)
    return [
        painted(Cone((0, 0, 0), 0.5, 0.4, 0.5), tex.weathered(side, rng)),
        painted(Disc((0, 0, 0.5), 0.4), tex.weathered(tex.plain(x, tex.CREAM), rng)),
    ]
