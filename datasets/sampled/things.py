"""Things: what stands about in a place, each of about a given radius on a given spot, of what the stock has."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..toy.lathe import Lathe
from ..toy.rod import Rod
from ..toy.shapes import Cone, Disc, Sphere, Torus, box
from .distribution import between, whole
from .materials import DIFFUSE, Surface
from .patterns import printed
from .solids import Knot, Lump, Superellipsoid, blobs
from .stock import Stock, Vector

Thing = Callable[[Stock, Vector, float], list[Surface]]


def ball(stock: Stock, base: Vector, size: float) -> list[Surface]:
    x, y, z = base
    return stock.surfaces([Sphere((x, y, z + 0.75 * size), 0.75 * size)], stock.finish(solid=True))


def vase(stock: Stock, base: Vector, size: float) -> list[Surface]:
    """Of an S-shaped profile: a vase, a jug or an urn."""
    rng, tall = stock.rng, size * between(stock.rng, (1.6, 2.8))
    rim, neck, belly = (
        size * between(rng, (0.3, 0.6)),
        size * between(rng, (0.2, 0.4)),
        size * between(rng, (0.55, 0.9)),
    )
    low = between(rng, (0.25, 0.5))
    profile = ((rim, tall), (neck, 0.82 * tall), (belly, low * tall), (0.6 * belly, 0.06 * tall), (0.5 * belly, 0.0))
    return stock.surfaces([Lathe(base, profile)], stock.finish())


def bowl(stock: Stock, base: Vector, size: float) -> list[Surface]:
    """With fruit or balls in it."""
    tall = size * between(stock.rng, (0.5, 0.8))
    profile = ((size, tall), (0.85 * size, 0.5 * tall), (0.5 * size, 0.12 * tall), (0.3 * size, 0.0))
    parts = stock.surfaces([Lathe(base, profile)], stock.finish())
    fruit = stock.finish(solid=True)
    for angle in np.linspace(0, 2 * np.pi, whole(stock.rng, (3, 5)), endpoint=False):
        x, y = base[0] + 0.4 * size * np.cos(angle), base[1] + 0.4 * size * np.sin(angle)
        parts += stock.surfaces([Sphere((x, y, base[2] + 0.75 * tall), 0.3 * size)], fruit)
    return parts


def tin(stock: Stock, base: Vector, size: float) -> list[Surface]:
    """A cylinder with a lid."""
    radius, tall = 0.6 * size, size * between(stock.rng, (0.8, 2.0))
    side, lid = stock.finish(), stock.finish()
    number, (x, y, z) = stock.thing(), base
    return [
        stock.surface(Cone(base, radius, radius * between(stock.rng, (0.8, 1.0)), tall), side, number),
        stock.surface(Disc((x, y, z + tall), radius), lid, number),
        stock.surface(Torus((x, y, z + tall), radius, 0.05 * size), lid, number),
    ]


def crate(stock: Stock, base: Vector, size: float) -> list[Surface]:
    """A box, or a pile of two."""
    rng, finish = stock.rng, stock.finish()
    edges = (size * between(rng, (0.9, 1.4)), size * between(rng, (0.7, 1.2)), size * between(rng, (0.6, 1.5)))
    turn = between(rng, (0, 90))
    parts = stock.surfaces(list(box(base, edges, turn)), finish)
    if rng.uniform() < 0.35:
        top = (base[0], base[1], base[2] + edges[2])
        smaller = (0.7 * edges[0], 0.7 * edges[1], 0.5 * edges[2])
        parts += stock.surfaces(list(box(top, smaller, turn + 20)), stock.finish())
    return parts


def stack_of_books(stock: Stock, base: Vector, size: float) -> list[Surface]:
    parts, height = [], base[2]
    for _ in range(whole(stock.rng, (2, 5))):
        thick = 0.22 * size * between(stock.rng, (0.6, 1.3))
        edges = (1.5 * size * between(stock.rng, (0.8, 1)), 1.1 * size * between(stock.rng, (0.8, 1)), thick)
        cover = (stock.finish()[0], printed(stock.color(), stock.white))
        faces = box((base[0], base[1], height), edges, between(stock.rng, (-25, 25)))
        parts += stock.surfaces(list(faces), cover if cover[0].name in ("satin", "lacquer") else (DIFFUSE, cover[1]))
        height += thick
    return parts


def knot(stock: Stock, base: Vector, size: float) -> list[Surface]:
    """A knotted tube on a foot."""
    turns = ((2, 3), (3, 2), (2, 5), (3, 4))[int(stock.rng.integers(4))]
    x, y, z = base
    shape = Knot((x, y, z + 0.62 * size), size, size * between(stock.rng, (0.1, 0.17)), turns)
    foot = stock.surfaces(list(box(base, (0.8 * size, 0.8 * size, 0.15 * size), 0)), stock.finish())
    return [*stock.surfaces([shape], stock.finish()), *foot]


def stone(stock: Stock, base: Vector, size: float) -> list[Surface]:
    """A boulder or an abstract sculpture, smooth and bumpy."""
    rng = stock.rng
    bumps = tuple(
        (between(rng, (0.02, 0.16)) / n, tuple((1.6 * n * rng.normal(size=3)).tolist()), between(rng, (0, 6.28)))
        for n in (1, 1, 2, 2, 3)
    )
    flat = between(rng, (0.6, 1.4))
    x, y, z = base
    return stock.surfaces([Lump((x, y, z + 0.7 * size * flat), 0.8 * size, bumps, flat)], stock.finish(solid=True))


def figure(stock: Stock, base: Vector, size: float) -> list[Surface]:
    """A standing shape of balls that run into each other, as a mesh."""
    rng, count = stock.rng, whole(stock.rng, (4, 7))
    heights = np.linspace(0.3, 2.0, count) * size
    sideways = 0.3 * size * rng.normal(size=(count, 2))
    centers = np.array(base) + np.column_stack([sideways, heights])
    radii = size * rng.uniform(0.18, 0.34, count)
    return [stock.surface(blobs(centers, radii), stock.finish(), stock.thing())]


def ring_toy(stock: Stock, base: Vector, size: float) -> list[Surface]:
    """Rings of falling size on a stick, with a ball on top."""
    parts, (x, y, height) = [], base
    for scale in np.linspace(1, 0.45, 4):
        tube = 0.22 * size * scale
        parts += stock.surfaces([Torus((x, y, height + tube), 0.62 * size * scale, tube)], stock.finish())
        height += 1.7 * tube
    stick = stock.surfaces([Rod(base, (x, y, height), 0.07 * size)], (DIFFUSE, printed(stock.white, stock.color())))
    return [*parts, *stick, *stock.surfaces([Sphere((x, y, height + 0.15 * size), 0.22 * size)], stock.finish())]


def candlestick(stock: Stock, base: Vector, size: float) -> list[Surface]:
    tall = 2.2 * size
    profile = ((0.2, 1.0), (0.24, 0.97), (0.1, 0.9), (0.13, 0.7), (0.07, 0.5), (0.2, 0.2), (0.3, 0.06), (0.5, 0.0))
    shape = Lathe(base, tuple((size * radius, tall * height) for radius, height in profile))
    x, y, z = base
    wax = Rod((x, y, z + tall), (x, y, z + tall + 0.7 * size), 0.09 * size)
    candle = stock.surfaces([wax], (DIFFUSE, printed(stock.white, stock.white)))
    return [*stock.surfaces([shape], stock.finish()), *candle]


def appliance(stock: Stock, base: Vector, size: float) -> list[Surface]:
    """A box with round edges and a knob: a toaster, a radio, a machine."""
    rng, (x, y, z) = stock.rng, base
    half = (size * between(rng, (0.7, 1.1)), size * between(rng, (0.5, 0.7)), size * between(rng, (0.45, 0.8)))
    turn = between(rng, (0, 180))
    body = Superellipsoid((x, y, z + half[2]), half, between(rng, (4, 9)), turn)
    knob = Sphere((x, y, z + 2 * half[2]), 0.16 * size)
    return [*stock.surfaces([body], stock.finish()), *stock.surfaces([knob], stock.finish())]


def plant(stock: Stock, base: Vector, size: float) -> list[Surface]:
    """A pot with leaves: flat ellipsoids about a stem."""
    rng, (x, y, z) = stock.rng, base
    parts = stock.surfaces([Cone(base, 0.4 * size, 0.55 * size, 0.7 * size)], stock.finish())
    leaf = (DIFFUSE, printed((0.25, 0.45, 0.2), (0.18, 0.36, 0.14)))
    leaves = []
    for _ in range(whole(rng, (9, 14))):
        angle, height = rng.uniform(0, 2 * np.pi), z + size * rng.uniform(0.8, 1.9)
        away = 0.45 * size * rng.uniform(0.3, 1)
        center = (x + away * np.cos(angle), y + away * np.sin(angle), height)
        leaves.append(Superellipsoid(center, (0.34 * size, 0.1 * size, 0.05 * size), 2, float(np.degrees(angle))))
    return [*parts, *stock.surfaces([Rod((x, y, z), (x, y, z + 1.6 * size), 0.04 * size), *leaves], leaf)]


SMALL: tuple[Thing, ...] = (
    ball,
    vase,
    bowl,
    tin,
    crate,
    stack_of_books,
    knot,
    ring_toy,
    candlestick,
    appliance,
    figure,
)
LARGE: tuple[Thing, ...] = (ball, vase, crate, knot, stone, figure, tin, plant)


def scattered(
    stock: Stock, things: tuple[Thing, ...], count: int, around: Vector, reach: float, sizes: tuple[float, float]
) -> list[Surface]:
    """`count` things on a disc of radius `reach`, none in another; fewer where there is no room."""
    placed: list[tuple[float, float, float]] = []
    parts: list[Surface] = []
    for _ in range(12 * count):
        if len(placed) == count:
            break
        size = between(stock.rng, sizes)
        away, angle = (reach - 0.6 * size) * np.sqrt(stock.rng.uniform()), stock.rng.uniform(0, 2 * np.pi)
        x, y = away * np.cos(angle), away * np.sin(angle)
        if all(np.hypot(x - px, y - py) > 0.95 * (size + other) for px, py, other in placed):
            placed.append((x, y, size))
            thing = things[int(stock.rng.integers(len(things)))]
            parts += thing(stock, (around[0] + x, around[1] + y, around[2]), size)
    return parts
