"""Outdoors, and tabletops: courtyards, plazas, a vehicle, ponds, and what stands on a table before a panorama."""

from __future__ import annotations

import numpy as np

from ..toy.rod import Rod
from ..toy.shapes import Cone, Disc, Shape, box
from ..toy.waves import Wave, Waves
from . import patterns as pat
from . import place as built
from .distribution import (
    DARK_PLAZA,
    DAYLIGHT,
    FLOOR_ROUGHNESS,
    POLISHED_FLOOR,
    TABLE_LIGHT,
    THINGS,
    between,
    one_of,
    whole,
)
from .light import panorama
from .materials import DIFFUSE, WATER, Surface, drawn_material
from .place import Place
from .solids import Superellipsoid
from .stock import Finish, Stock
from .things import LARGE, SMALL, candlestick, crate, figure, knot, plant, scattered, stone, vase

FAR = 8.0  # how far the ground is modeled


def tabletop(rng: np.random.Generator) -> Place:
    """Things on a table or a plate, in a studio, a hall or out of doors."""
    stock = Stock(rng, liked=("glass", "lacquer"))
    cloth = pat.weave([stock.color(), stock.white, stock.color()], between(rng, (0.1, 0.3)))
    tops = (pat.wood((0.5, 0.34, 0.2), 0.18), pat.marble(stock.white), pat.slabs([stock.color(), stock.white], 0.25))
    pattern = (*tops, cloth)[int(rng.integers(4))]
    coated = pattern is not cloth and rng.uniform() < 0.7 * stock.shining
    finish: Finish = (built.polished(stock, between(rng, FLOOR_ROUGHNESS)) if coated else DIFFUSE, pattern)
    radius = between(rng, (1.0, 1.3))
    if rng.uniform() < 0.5:
        parts = stock.surfaces([Disc((0, 0, 0), radius), Cone((0, 0, -0.08), radius, radius, 0.08)], finish)
    else:
        parts = stock.surfaces(list(box((0, 0, -0.08), (2 * radius, 1.6 * radius, 0.08), 0)), finish)
    parts += stock.surfaces([Cone((0, 0, -1.3), 0.5, 0.2, 1.25)], (DIFFUSE, pat.wood((0.4, 0.28, 0.18), 0.2)))
    kind = one_of(rng, TABLE_LIGHT)
    below = (pat.wood((0.3, 0.22, 0.16), 0.25), pat.slabs([(0.5, 0.48, 0.45), (0.42, 0.4, 0.38)], 0.7))
    parts.append(stock.surface(Disc((0, 0, -1.3), 4.0), (DIFFUSE, below[int(rng.integers(2))]), stock.thing()))
    parts += scattered(stock, SMALL, whole(rng, THINGS["tabletop"]), (0, 0, 0), 0.85 * radius, (0.16, 0.34))
    sky = panorama(kind, np.array([0.15, 0.15, 0.13]), rng)
    return Place("tabletop", parts, sky, (0.0, 0.0, 0.15), (1.5, 2.2), (0.5, 1.4))


def courtyard(rng: np.random.Generator) -> Place:
    """Paved, with walls on two to four sides, a basin or a group of things in the middle, planters, a bench."""
    stock = Stock(rng)
    half, height = (between(rng, (2.9, 3.6)), between(rng, (2.9, 3.8))), between(rng, (1.6, 2.8))
    pavings = (
        pat.slabs([(0.66, 0.62, 0.56), (0.58, 0.54, 0.5)], 0.5),
        pat.cobbles((0.5, 0.47, 0.44), 0.16),
        pat.brick((0.58, 0.36, 0.28), (0.6, 0.58, 0.54)),
    )
    polished = rng.uniform() < POLISHED_FLOOR["courtyard"]
    ground: Finish = (
        built.polished(stock, between(rng, FLOOR_ROUGHNESS)) if polished else DIFFUSE,
        pavings[int(rng.integers(3))],
    )
    parts = [stock.surface(built.flat((0, 0, 0), 2 * half[0] + 0.04, 2 * half[1] + 0.04), ground, stock.thing())]
    facades = (
        pat.brick((0.62, 0.36, 0.27), (0.72, 0.7, 0.66)),
        pat.plaster((0.86, 0.74, 0.55)),
        pat.plaster(stock.white),
    )
    front = facades[int(rng.integers(3))]
    facade: Finish = (DIFFUSE, front)
    for wall in built.four_walls(half, height)[: whole(rng, (2, 4))]:
        parts += built.walled(stock, wall, facade)
        door = pat.wood(stock.color(), 0.2)
        at = between(rng, (-0.5, 0.5))
        parts += built.hung(stock, wall, (at - 0.45, 0.0, at + 0.45, min(2.0, height - 0.2)), (DIFFUSE, door), front)
        for right in (-1.8, 1.8):
            pane = (
                stock.finish() if rng.uniform() < 0.3 else (DIFFUSE, pat.leaded([(0.2, 0.25, 0.3), (0.3, 0.36, 0.42)]))
            )
            frame = (right - 0.4, 0.7, right + 0.4, min(1.6, height - 0.2))
            parts += built.hung(stock, wall, frame, pane, pat.plaster(stock.white))
    parts += _corners(stock, half)
    count = whole(rng, THINGS["courtyard"])
    if rng.uniform() < 0.45:
        parts += _basin(stock)
    else:
        parts += scattered(stock, LARGE, count, (0, 0, 0), 1.0, (0.25, 0.45))
    sky = panorama(one_of(rng, DAYLIGHT), np.array([0.22, 0.2, 0.17]), rng)
    return Place("courtyard", parts, sky, (0.0, 0.0, 0.4), (1.7, min(half) - 0.5), (0.9, 1.9), half)


def plaza(rng: np.random.Generator) -> Place:
    """A polished dark floor under a bright sky, with bright metals and columns on it."""
    stock = Stock(rng, liked=("smooth_metal", "brushed_metal", "lacquer"))
    base = pat.slabs([stock.white, (0.7, 0.68, 0.66), stock.color()], between(rng, (0.6, 1.2)))
    floor: Finish = (built.polished(stock, between(rng, FLOOR_ROUGHNESS)), base)
    shape = built.flat((0, 0, 0), 2 * FAR, 2 * FAR)
    parts = [stock.surface(shape, floor, stock.thing(), darker=between(rng, DARK_PLAZA))]
    parts += scattered(stock, (*LARGE, candlestick), whole(rng, THINGS["plaza"]), (0, 0, 0), 1.15, (0.25, 0.45))
    column: Finish = (DIFFUSE, pat.marble((0.85, 0.82, 0.76)))
    for angle in rng.uniform(0, 6.28) + np.arange(whole(rng, (0, 8))) * 2 * np.pi / 8:
        x, y = float(4.2 * np.cos(angle)), float(4.2 * np.sin(angle))
        side = Cone((x, y, 0.1), 0.26, 0.22, 2.6)
        cap: list[Shape] = [*box((x, y, 0), (0.7, 0.7, 0.1), 0), *box((x, y, 2.7), (0.7, 0.7, 0.12), 0)]
        parts += stock.surfaces([side, *cap], column)
    sky = panorama(one_of(rng, DAYLIGHT), np.array([0.16, 0.16, 0.15]), rng)
    return Place("plaza", parts, sky, (0.0, 0.0, 0.35), (1.8, 2.7), (0.7, 1.6))


def vehicle(rng: np.random.Generator) -> Place:
    """A car on a road or a yard, things beside it."""
    stock = Stock(rng)
    grounds = (
        pat.asphalt((0.3, 0.3, 0.31), (0.85, 0.83, 0.75)),
        pat.cobbles((0.5, 0.48, 0.45), 0.2),
        pat.concrete((0.55, 0.54, 0.52)),
        pat.grass((0.30, 0.34, 0.17)),
    )
    ground = stock.surface(built.flat((0, 0, 0), 16, 16), (DIFFUSE, grounds[int(rng.integers(4))]), stock.thing())
    parts = [ground, *_car(stock)]
    for x, y in ((1.9, 1.3), (-1.8, -1.4), (1.7, -1.5), (-1.9, 1.2)):
        if rng.uniform() < 0.6:
            thing = (crate, plant, stone, vase)[int(rng.integers(4))]
            parts += thing(stock, (x + 0.2 * rng.normal(), y + 0.2 * rng.normal(), 0.0), between(rng, (0.22, 0.36)))
    sky = panorama(one_of(rng, DAYLIGHT), np.array([0.2, 0.2, 0.17]), rng)
    return Place("vehicle", parts, sky, (0.0, 0.0, 0.42), (2.5, 3.4), (0.7, 1.7))


def pond(rng: np.random.Generator) -> Place:
    """Water with gentle waves in a meadow: stones around it, lily pads, a rail, and a statue."""
    stock = Stock(rng, liked=("smooth_metal",))
    waves = tuple(
        Wave(between(rng, (0.001, 0.006)), between(rng, (-9, 9)), between(rng, (-9, 9)), rng.uniform())
        for _ in range(5)
    )
    murky = pat.cobbles((0.16, 0.2, 0.14), 0.2)
    water = Waves((-2, 2, 0), (4, 0, 0), (0, -4, 0), waves)
    meadow = pat.grass((0.28, 0.33, 0.16))
    parts = [
        stock.surface(water, (WATER, murky), stock.thing(), darker=0.6),
        stock.surface(_frame_of_ground(), (DIFFUSE, meadow), stock.thing()),
    ]
    for angle in np.arange(0, 2 * np.pi, 0.33) + rng.uniform(-0.06, 0.06, 20):
        spot = (float(1.72 * np.cos(angle)), float(1.72 * np.sin(angle)), -0.08)
        boulder = stone(stock, spot, between(rng, (0.16, 0.32)))
        gray: Finish = (DIFFUSE, pat.concrete(tuple(np.full(3, between(rng, (0.35, 0.6))) + 0.04 * rng.normal(size=3))))
        parts += boulder if rng.uniform() < 0.1 else [stock.surface(b.shape, gray, b.thing) for b in boulder]
    for _ in range(whole(rng, (4, 9))):
        away, angle = 1.3 * np.sqrt(rng.uniform(0.1, 1)), rng.uniform(0, 6.28)
        pad = Disc((float(away * np.cos(angle)), float(away * np.sin(angle)), 0.02), between(rng, (0.08, 0.18)))
        parts += stock.surfaces([pad], (DIFFUSE, pat.glaze((0.2, 0.42, 0.16), (0.28, 0.5, 0.2))))
    island = list(box((0, 0, -0.05), (0.6, 0.6, 0.25), between(rng, (0, 90))))
    parts += stock.surfaces(island, (DIFFUSE, pat.concrete((0.6, 0.58, 0.55))))
    parts += (figure, knot, vase, stone)[int(rng.integers(4))](stock, (0.0, 0.0, 0.2), between(rng, (0.28, 0.4)))
    sky = panorama(one_of(rng, DAYLIGHT), np.array([0.16, 0.2, 0.09]), rng)
    return Place("pond", parts, sky, (0.0, 0.0, 0.2), (2.1, 2.8), (0.8, 1.6))


def _frame_of_ground() -> Disc:
    return Disc((0, 0, 0.03), FAR, 1.68)


def _corners(stock: Stock, half: tuple[float, float]) -> list[Surface]:
    """Planters in corners, and a bench."""
    parts = []
    for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        if stock.rng.uniform() < 0.7:
            parts += plant(stock, (x * (half[0] - 0.55), y * (half[1] - 0.55), 0.0), between(stock.rng, (0.4, 0.6)))
    bench = list(box((half[0] - 0.4, 0, 0), (0.45, 1.5, 0.45), 0))
    return [*parts, *stock.surfaces(bench, (DIFFUSE, pat.wood((0.5, 0.38, 0.26), 0.1)))]


def _basin(stock: Stock) -> list[Surface]:
    """A fountain: a square wall around water, a thing on a column in it."""
    rim: list[Shape] = []
    for side in (-0.85, 0.85):
        rim += [*box((side, 0, 0), (0.16, 1.86, 0.4), 0), *box((0, side, 0), (1.86, 0.16, 0.4), 0)]
    parts = stock.surfaces(rim, (DIFFUSE, pat.concrete((0.62, 0.6, 0.56))))
    waves = tuple(Wave(0.002, float(a), float(b), 0.1 * a) for a, b in stock.rng.uniform(-5, 5, (4, 2)))
    water = Waves((-0.8, 0.8, 0.32), (1.6, 0, 0), (0, -1.6, 0), waves)
    tiles = pat.slabs([(0.2, 0.42, 0.5), (0.16, 0.35, 0.45)], 0.15)
    parts.append(stock.surface(water, (WATER, tiles), stock.thing(), darker=0.7))
    parts += stock.surfaces([Cone((0, 0, 0.2), 0.16, 0.12, 0.5)], (DIFFUSE, pat.marble(stock.white)))
    return [*parts, *(knot, vase, figure, stone)[int(stock.rng.integers(4))](stock, (0.0, 0.0, 0.7), 0.3)]


def _car(stock: Stock) -> list[Surface]:
    """Body, cabin with dark windows, four wheels with bright hubs, lights and bumpers."""
    rng, turn = stock.rng, 0.0
    paint = drawn_material(rng, ("car_paint", "lacquer", "car_paint")[int(rng.integers(3))])
    body: Finish = (paint, pat.plaster(stock.color()))
    number = stock.thing()
    long, wide = between(rng, (1.05, 1.3)), between(rng, (0.46, 0.54))
    roof = between(rng, (0.24, 0.34))
    hull: list[Shape] = [
        Superellipsoid((0, 0, 0.42), (long, wide, 0.22), between(rng, (3.5, 5)), turn),
        Superellipsoid((-0.12, 0, 0.62 + 0.55 * roof), (0.55 * long, 0.86 * wide, roof), between(rng, (2.8, 4)), turn),
    ]
    parts = [stock.surface(shape, body, number) for shape in hull]
    glass: Finish = (drawn_material(rng, "lacquer"), pat.plaster((0.05, 0.06, 0.07)))
    middle = 0.62 + 0.5 * roof
    band = Superellipsoid((-0.12, 0, middle), (0.562 * long, 0.885 * wide, 0.66 * roof), 3.0, turn)
    parts.append(stock.surface(band, glass, number))
    chrome: Finish = (drawn_material(rng, "smooth_metal"), None)
    rubber: Finish = (DIFFUSE, pat.plaster((0.07, 0.07, 0.07)))
    for x in (-0.62 * long, 0.62 * long):
        for side in (-1, 1):
            parts += _wheel(stock, x, side * 0.95 * wide, rubber, chrome)
    for side in (-1, 1):
        for end, finish in ((1, chrome), (-1, (DIFFUSE, pat.plaster((0.6, 0.05, 0.04))))):
            light = Superellipsoid((end * 0.93 * long, side * 0.62 * wide, 0.48), (0.09, 0.1, 0.07), 2, 0)
            parts.append(stock.surface(light, finish, number))
    bar = [Rod((end * 1.0 * long, -0.8 * wide, 0.3), (end * 1.0 * long, 0.8 * wide, 0.3), 0.04) for end in (-1, 1)]
    return [*parts, *[stock.surface(shape, chrome, number) for shape in bar]]


def _wheel(stock: Stock, x: float, y: float, rubber: Finish, chrome: Finish) -> list[Surface]:
    tire = Superellipsoid((x, y, 0.2), (0.2, 0.09, 0.2), 2.6, 0)
    out = 1 if y > 0 else -1
    hub = Superellipsoid((x, y + out * 0.055, 0.2), (0.12, 0.05, 0.12), 2, 0)
    number = stock.thing()
    return [stock.surface(tire, rubber, number), stock.surface(hub, chrome, number)]
