"""`lacquered_table`: curved gloss over painted patterns, half of it showing things nearby and half the sky."""

from __future__ import annotations

import numpy as np

from ...formats.srgb import to_linear
from .. import textures as tex
from ..lathe import Lathe
from ..rod import Rod
from ..shapes import Cone, Disc, Rectangle, Shape, Sphere, box
from ..sky import panorama
from ..world import Part
from .description import Array, Description, Orbit, painted

TERRACE = 4.0  # from the middle to its edge
TABLE = ((0.0, 0.775), (0.3, 0.77), (0.62, 0.755), (0.88, 0.725), (0.955, 0.69), (0.93, 0.645), (0.84, 0.625))


def lacquered_table(rng: np.random.Generator) -> Description:
    """A domed table and vases under lacquer, on a terrace under an awning on one side and open sky on the other."""
    parts = [*_terrace(rng), *_screens(rng), *_awning(rng), *_columns(rng), *_table(rng), *_table_ware(rng)]
    return Description(parts, panorama(rng), Orbit((0, 0, 0.72), 2.2, 0.2, 1.55, 0.35, 56), far_points=500)


def _terrace(rng: np.random.Generator) -> list[Part]:
    side = 2 * TERRACE
    x, y = tex.grid(side, side)
    floor = tex.weathered(tex.tiles(x, y, 1.0, rng), rng)
    x, y = tex.grid(side, 0.5)
    parts = [painted(Rectangle((-TERRACE, TERRACE, 0), (side, 0, 0), (0, -side, 0)), floor)]
    for turn in range(0, 360, 90):
        edge = box((0, 0, -0.5), (side, side, 0.5), turn)[0]
        parts.append(painted(edge, tex.weathered(tex.checker(x, y, 0.25, (tex.CREAM, tex.TEAL)), rng)))
    return parts


def _screens(rng: np.random.Generator) -> list[Part]:
    """Four panels in a zigzag behind the table, where +y is."""
    width, height = 1.25, 2.1
    x, y = tex.grid(width, height)
    wave = y + 0.15 * np.sin(2 * np.pi * x / 0.9)
    pictures = [
        tex.sunburst(x, y, (width / 2, 1.2), 18, (tex.VERMILION, tex.CREAM)),
        tex.glyphs(x, y, 0.4, (tex.INK, tex.VERMILION, tex.TEAL), tex.CREAM, rng),
        tex.stripes(x, wave, 90, 1.5, (tex.PLUM, tex.MUSTARD, tex.CREAM, tex.GREEN, tex.INK, tex.SKY)),
        tex.harlequin(x, y, 0.42, 0.7, (tex.TEAL, tex.MUSTARD, tex.CREAM)),
    ]
    parts = []
    bends = [_at(3.0, degrees) + _at(0.25 * (-1) ** i, degrees) for i, degrees in enumerate((38, 64, 90, 116, 142))]
    for left, right, picture in zip(bends[1:], bends[:-1], pictures, strict=True):
        corner, across = left + np.array([0, 0, height]), right - left
        panel = Rectangle(tuple(corner.tolist()), tuple(across.tolist()), (0, 0, -height))
        parts.append(painted(panel, tex.weathered(tex.framed(picture, tex.INK, 0.06), rng)))
    return parts


def _awning(rng: np.random.Generator) -> list[Part]:
    """Striped cloth above the screens, on four poles, reaching to above the table."""
    x, y = tex.grid(7.0, 3.4)
    cloth = tex.stripes(x, y, 0, 1.4, (tex.VERMILION, tex.CREAM, tex.TEAL, tex.CREAM, tex.MUSTARD, tex.CREAM))
    tex.paint(cloth, (y % 0.85) < 0.12, tex.INK)
    parts = [painted(Rectangle((-3.5, 3.5, 2.35), (7.0, 0, 0), (0, -3.35, 0.55)), tex.weathered(cloth, rng))]
    for x_pole, y_pole, height in ((-3.4, 3.4, 2.36), (3.4, 3.4, 2.36), (-3.4, 0.2, 2.88), (3.4, 0.2, 2.88)):
        pole = Rod((x_pole, y_pole, 0), (x_pole, y_pole, height), 0.06)
        x, y = tex.grid(*pole.extent)
        parts.append(painted(pole, tex.weathered(tex.stripes(x, y, 90, 0.5, (tex.INK, tex.CREAM)), rng)))
    return parts


def _columns(rng: np.random.Generator) -> list[Part]:
    """Striped posts at the open side, each with a lantern."""
    parts = []
    for degrees, height in ((185, 1.9), (230, 1.5), (275, 2.0), (320, 1.6), (355, 1.9)):
        foot = _at(3.1, degrees)
        post = Rod(tuple(foot.tolist()), tuple((foot + np.array([0, 0, height])).tolist()), 0.13)
        x, y = tex.grid(*post.extent)
        picture = tex.stripes(x, y, 60, 0.4, (tex.VERMILION, tex.CREAM, tex.TEAL, tex.CREAM))
        parts.append(painted(post, tex.weathered(picture, rng)))
        lantern = Sphere((float(foot[0]), float(foot[1]), height + 0.15), 0.22)
        x, y = tex.grid(*lantern.extent)
        parts.append(painted(lantern, tex.weathered(tex.checker(x, y, 0.17, (tex.MUSTARD, tex.VERMILION)), rng)))
    return parts


def _table(rng: np.random.Generator) -> list[Part]:
    """A domed marquetry top under clear lacquer, on a painted foot."""
    top = Lathe((0, 0, 0), TABLE)
    u, v = (axis / length for axis, length in zip(tex.grid(*top.extent), top.extent, strict=True))
    picture = tex.choose(np.floor(24 * u).astype(np.int64), ((0.30, 0.09, 0.05), (0.86, 0.56, 0.24)))
    tex.paint(picture, (v < 0.30), (0.10, 0.08, 0.10))
    petals = (v < 0.25) & (v < 0.16 + 0.09 * np.abs(np.sin(8 * np.pi * u)))
    tex.paint(picture, petals, tex.MUSTARD)
    tex.paint(picture, (v < 0.11), tex.VERMILION)
    tex.paint(picture, (v > 0.52) & (v < 0.60), (0.10, 0.08, 0.10))
    tex.paint(picture, (v > 0.545) & (v < 0.575), tex.MUSTARD)
    foot = Cone((0, 0, 0), 0.5, 0.16, 0.64)
    x, y = tex.grid(*foot.extent)
    x_underside, _ = tex.grid(*Disc((0, 0, 0.626), 0.85).extent)
    return [
        _lacquered(top, tex.weathered(picture, rng), 0.22, 0.1),
        painted(Disc((0, 0, 0.626), 0.85), tex.weathered(tex.plain(x_underside, tex.OAK), rng)),
        painted(foot, tex.weathered(tex.stripes(x, y, 90, 0.32, (tex.INK, tex.MUSTARD, tex.TEAL, tex.CREAM)), rng)),
    ]


def _table_ware(rng: np.random.Generator) -> list[Part]:
    """Two lacquered vases, a painted ball, and a lettered block."""
    tall = ((0.05, 0.50), (0.045, 0.44), (0.07, 0.36), (0.15, 0.24), (0.16, 0.13), (0.10, 0.03), (0.085, 0.0))
    low = ((0.0, 0.30), (0.06, 0.29), (0.17, 0.22), (0.22, 0.12), (0.17, 0.03), (0.12, 0.0))
    parts = []
    for profile, place, color, band in (
        (tall, _at(0.42, 60), (0.62, 0.06, 0.07), tex.MUSTARD),
        (low, _at(0.40, 215), (0.05, 0.10, 0.22), tex.CREAM),
    ):
        vase = Lathe((float(place[0]), float(place[1]), 0.758), profile)
        x, y = tex.grid(*vase.extent)
        picture = tex.plain(x, color)
        tex.paint(picture, abs(y / vase.extent[1] - 0.62) < 0.07, band)
        tex.paint(picture, (abs(y / vase.extent[1] - 0.45) < 0.06) & (np.sin(x / 0.03) > 0), band)
        parts.append(_lacquered(vase, tex.weathered(picture, rng), 0.28, 0.0))
    ball = Sphere((*_at(0.55, 330)[:2].tolist(), 0.88), 0.13)
    x, y = tex.grid(*ball.extent)
    pattern = tex.harlequin(x, y, ball.extent[0] / 6, 0.13, (tex.SKY, tex.CREAM, tex.INK))
    parts.append(painted(ball, tex.weathered(pattern, rng)))
    for face in box((*_at(0.5, 140)[:2].tolist(), 0.74), (0.24, 0.24, 0.24), 25):
        x, y = tex.grid(*face.extent)
        letter = tex.glyphs(x, 1.25 * y, 0.2401, (tex.CREAM,), tex.GREEN, rng)
        parts.append(painted(face, tex.weathered(letter, rng)))
    return parts


def _lacquered(shape: Shape, picture: Array, reflectance: float, roughness: float) -> Part:
    return Part(shape, to_linear(picture), reflectance, roughness)


def _at(distance: float, bearing_degrees: float) -> Array:
    bearing = np.radians(bearing_degrees)
    return np.array([distance * np.cos(bearing), distance * np.sin(bearing), 0.0])
