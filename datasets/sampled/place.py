"""Place: a sampled scene before any light falls on it, and what rooms and yards are built of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..toy.shapes import Array, Rectangle, Shape, box
from .materials import DIFFUSE, STAINED, Material, Surface
from .patterns import Pattern
from .stock import Finish, Stock, Vector

Opening = tuple[float, float, float, float]  # left, bottom, right, top on a wall, meters


@dataclass(frozen=True)
class Place:
    """All there is to know of a scene but its cameras. World units are meters, z is up."""

    name: str
    surfaces: list[Surface]
    sky: Array  # [H, W, 3] linear radiance
    target: Vector  # what cameras look at, more or less
    distance: tuple[float, float]  # of cameras from it, along the ground
    height: tuple[float, float]  # of cameras above the ground
    room: tuple[float, float] = (1e9, 1e9)  # half of the lengths along x and y that cameras stay within


def rectangle(corner: Array, across: Array, down: Array) -> Rectangle:
    return Rectangle(vector(corner), vector(across), vector(down))


def vector(values: Array) -> Vector:
    x, y, z = map(float, values)
    return x, y, z


def flat(center: Vector, width: float, depth: float) -> Rectangle:
    """A level rectangle that faces up."""
    x, y, z = center
    return Rectangle((x - width / 2, y + depth / 2, z), (width, 0, 0), (0, -depth, 0))


def ceiling(width: float, depth: float, height: float) -> Rectangle:
    return Rectangle((-width / 2, -depth / 2, height), (width, 0, 0), (0, depth, 0))


@dataclass(frozen=True)
class Wall:
    """One of four around the origin, seen from within: `along` runs to the right, `inward` into the room."""

    middle: Array  # [3] on the floor
    along: Array  # [3] unit
    inward: Array  # [3] unit
    length: float
    height: float

    def at(self, right: float, up: float, into: float = 0.0) -> Array:
        """The point at `right` of the wall's middle, `up` from the floor, and `into` the room."""
        return self.middle + right * self.along + up * np.array([0, 0, 1.0]) + into * self.inward

    def panel(self, left: float, bottom: float, right: float, top: float, into: float = 0.0) -> Rectangle:
        """A piece of the wall, or what hangs before it."""
        down = np.array([0, 0, bottom - top])
        return rectangle(self.at(left, top, into), (right - left) * self.along, down)

    def turn_degrees(self) -> float:
        return float(np.degrees(np.arctan2(self.along[1], self.along[0])))


def four_walls(half: tuple[float, float], height: float) -> list[Wall]:
    walls = []
    for inward in (np.array([0, -1.0, 0]), np.array([-1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([1.0, 0, 0])):
        reach = half[1] if inward[1] else half[0]
        length = 2 * (half[0] if inward[1] else half[1])
        walls.append(Wall(-inward * reach, np.array([-inward[1], inward[0], 0]), inward, length, height))
    return walls


def walled(stock: Stock, wall: Wall, finish: Finish, openings: tuple[Opening, ...] = ()) -> list[Surface]:
    """The wall around its openings, which do not overlap and are in order from left to right."""
    number, edge = stock.thing(), wall.length / 2 + 0.02
    pieces: list[Rectangle] = []
    start = -edge
    for left, bottom, right, top in openings:
        pieces += [wall.panel(start, 0, left, wall.height), wall.panel(left, top, right, wall.height)]
        if bottom > 0:
            pieces.append(wall.panel(left, 0, right, bottom))
        start = right
    pieces.append(wall.panel(start, 0, edge, wall.height))
    return [stock.surface(piece, finish, number) for piece in pieces]


def window(stock: Stock, wall: Wall, opening: Opening, frame: Pattern, glass: Pattern | None = None) -> list[Surface]:
    """Frame and bars of an opening, and stained glass of that pattern in it."""
    left, bottom, right, top = opening
    number, bars = stock.thing(), []
    for x in (left, (left + right) / 2, right):
        bars.append(wall.panel(x - 0.03, bottom, x + 0.03, top, 0.02))
    for y in (bottom, (bottom + top) / 2, top):
        bars.append(wall.panel(left - 0.03, y - 0.03, right + 0.03, y + 0.03, 0.025))
    parts = [stock.surface(bar, (DIFFUSE, frame), number) for bar in bars]
    if glass is not None:
        parts.append(stock.surface(wall.panel(left, bottom, right, top, -0.02), (STAINED, glass), stock.thing()))
    return parts


def against(stock: Stock, wall: Wall, right: float, size: Vector, finish: Finish, front: Finish) -> list[Surface]:
    """A cupboard against the wall, `size` wide, deep and high; its front has a finish of its own."""
    number = stock.thing()
    base = wall.at(right, 0, size[1] / 2 + 0.01)
    faces: list[Shape] = list(box((float(base[0]), float(base[1]), 0.0), size, wall.turn_degrees()))
    parts = [stock.surface(face, finish, number) for face in faces]
    panel = wall.panel(right - size[0] / 2, 0.02, right + size[0] / 2, size[2], size[1] + 0.015)
    return [*parts, stock.surface(panel, front, number)]


def hung(stock: Stock, wall: Wall, opening: Opening, picture: Finish, frame: Pattern) -> list[Surface]:
    """A picture or a mirror in its frame, on the wall."""
    left, bottom, right, top = opening
    number = stock.thing()
    border = wall.panel(left - 0.06, bottom - 0.06, right + 0.06, top + 0.06, 0.02)
    inside = wall.panel(left, bottom, right, top, 0.03)
    return [stock.surface(border, (DIFFUSE, frame), number), stock.surface(inside, picture, number)]


def table(stock: Stock, base: Vector, size: Vector, finish: Finish, turn_degrees: float = 0.0) -> list[Surface]:
    """A top on four legs; `size` is width, depth and height."""
    number, angle = stock.thing(), np.radians(turn_degrees)
    x, y, z = base
    faces: list[Shape] = list(box((x, y, z + size[2] - 0.05), (size[0], size[1], 0.05), turn_degrees))
    for across in (-0.45, 0.45):
        for along in (-0.45, 0.45):
            dx, dy = across * size[0], along * size[1]
            leg = (x + dx * np.cos(angle) - dy * np.sin(angle), y + dx * np.sin(angle) + dy * np.cos(angle), z)
            faces += box(leg, (0.06, 0.06, size[2] - 0.05), turn_degrees)
    return [stock.surface(face, finish, number) for face in faces]


def lamp(center: Vector, width: float, depth: float, radiance: float) -> Surface:
    """A panel that shines downward."""
    x, y, z = center
    shape = Rectangle((x - width / 2, y - depth / 2, z), (width, 0, 0), (0, depth, 0))
    return Surface(shape, DIFFUSE, np.array([1.0, 0.94, 0.85]).reshape(1, 1, 3), emission=radiance)


def polished(stock: Stock, roughness: float) -> Material:
    """Of a floor: under a smooth coat, or one that is worn."""
    return Material("lacquer" if roughness < 0.08 else "varnish", roughness if roughness >= 0.08 else 0.0)
