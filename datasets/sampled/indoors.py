"""Indoors: rooms, galleries and chapels."""

from __future__ import annotations

import numpy as np

from ..toy.lathe import Lathe
from ..toy.rod import Rod
from ..toy.shapes import Disc, box
from . import patterns as pat
from . import place as built
from .distribution import (
    DAYLIGHT,
    FLOOR_ROUGHNESS,
    LAMPS,
    POLISHED_FLOOR,
    SHOWCASE,
    THINGS,
    WALL_MIRROR,
    between,
    one_of,
    whole,
)
from .light import panorama
from .materials import DIFFUSE, MIRROR, PANE, Surface
from .place import Place, Wall
from .solids import Superellipsoid
from .stock import Finish, Stock, Vector
from .things import LARGE, SMALL, figure, knot, plant, scattered, stone, vase

OAK = (0.52, 0.36, 0.22)
GROUND = (0.2, 0.2, 0.17)  # outside of windows, linear


def room(rng: np.random.Generator) -> Place:
    """A living room: a window, furniture along the walls, a table or a rug with things in the middle."""
    stock = Stock(rng, liked=("lacquer",))
    half, height = (between(rng, (2.5, 3.2)), between(rng, (2.5, 3.6))), between(rng, (2.5, 3.0))
    walls = built.four_walls(half, height)
    parts = _shell(stock, half, height, _floor(stock, "room"))
    paper: Finish = (DIFFUSE, _wallpaper(stock))
    opening = (-between(rng, (0.5, 1.1)), 0.8, between(rng, (0.5, 1.1)), 2.15)
    white = pat.plaster(stock.white)
    parts += built.walled(stock, walls[0], paper, (opening,)) + built.window(stock, walls[0], opening, white)
    for wall in walls[1:]:
        parts += built.walled(stock, wall, paper)
    parts += _along(stock, walls)
    count = whole(rng, THINGS["room"])
    if rng.uniform() < 0.7:
        top = between(rng, (0.55, 0.75))
        size = (between(rng, (1.1, 1.6)), between(rng, (0.9, 1.2)), top)
        parts += built.table(stock, (0, 0, 0), size, _wooden(stock), between(rng, (0, 60)))
        parts += scattered(stock, SMALL, count, (0, 0, top), 0.48, (0.1, 0.2))
        parts += _chairs(stock)
        target = (0.0, 0.0, top + 0.05)
    else:
        rug = built.flat((0, 0, 0.01), between(rng, (1.8, 2.4)), between(rng, (1.4, 2.0)))
        parts.append(stock.surface(rug, (DIFFUSE, pat.rug(stock.colors)), stock.thing()))
        parts += scattered(stock, LARGE, count, (0, 0, 0.01), 0.95, (0.22, 0.42))
        target = (0.0, 0.0, 0.4)
    return _inside("room", stock, parts, half, height, target)


def gallery(rng: np.random.Generator) -> Place:
    """White walls with paintings and now and then a mirror; sculptures on plinths, sometimes under glass."""
    stock = Stock(rng, liked=("smooth_metal", "brushed_metal", "car_paint"))
    half, height = (between(rng, (2.8, 3.4)), between(rng, (2.8, 3.8))), between(rng, (2.8, 3.3))
    parts = _shell(stock, half, height, _floor(stock, "gallery"))
    white: Finish = (DIFFUSE, pat.plaster(pat.blend(stock.white, (0.0, 0.0, 0.0), 0.03)))
    for index, wall in enumerate(built.four_walls(half, height)):
        opening = (-0.6, 0.0, 0.6, 2.1) if index == 3 and rng.uniform() < 0.5 else None
        parts += built.walled(stock, wall, white, (opening,) if opening else ())
        for right in (-1.9, 0.0, 1.9):
            if abs(right) + 0.7 > wall.length / 2 or (opening and not right):
                continue
            wide, tall = between(rng, (0.4, 0.75)), between(rng, (0.35, 0.6))
            mirrored = rng.uniform() < WALL_MIRROR["gallery"] / 2
            shown: Finish = (MIRROR, None) if mirrored else (DIFFUSE, pat.canvas(stock.colors))
            frame = pat.plaster(stock.black if rng.uniform() < 0.5 else OAK)
            parts += built.hung(stock, wall, (right - wide, 1.45 - tall, right + wide, 1.45 + tall), shown, frame)
    spots = [(0.0, 0.0)] + [
        (1.15 * np.cos(a), 1.15 * np.sin(a)) for a in rng.uniform(0, 1.5) + np.arange(4) * np.pi / 2
    ]
    for x, y in spots[: whole(rng, THINGS["gallery"])]:
        parts += _on_plinth(stock, x, y)
    return _inside("gallery", stock, parts, half, height, (0.0, 0.0, 0.75))


def chapel(rng: np.random.Generator) -> Place:
    """Stone, stained glass that the day shines through, a polished floor, gilt things on an altar, benches."""
    stock = Stock(rng, liked=("smooth_metal", "varnish"))
    half, height = (between(rng, (2.6, 3.1)), between(rng, (2.9, 3.6))), between(rng, (3.2, 4.0))
    parts = _shell(stock, half, height, _floor(stock, "chapel"))
    stone_wall: Finish = (DIFFUSE, pat.slabs([(0.66, 0.62, 0.54), (0.6, 0.57, 0.5), (0.7, 0.66, 0.6)], 0.45))
    vivid = [(0.75, 0.08, 0.06), (0.08, 0.18, 0.7), (0.9, 0.65, 0.1), (0.1, 0.5, 0.2), (0.8, 0.8, 0.85)]
    for index, wall in enumerate(built.four_walls(half, height)):
        places = (-1.3, 0.0, 1.3) if wall.length > 5.5 and index % 2 else (0.0,) if index != 2 else ()
        openings = tuple((at - 0.45, 0.9, at + 0.45, height - 0.5) for at in places)
        parts += built.walled(stock, wall, stone_wall, openings)
        for opening in openings:
            parts += built.window(stock, wall, opening, pat.plaster((0.12, 0.12, 0.12)), pat.leaded(vivid))
    parts += built.table(stock, (0, 0, 0), (1.3, 0.8, 0.8), (DIFFUSE, pat.wood(OAK, 0.1)), between(rng, (0, 40)))
    parts += scattered(stock, SMALL, whole(rng, THINGS["chapel"]), (0, 0, 0.8), 0.45, (0.1, 0.18))
    for side in (-1, 1):
        for y in (-1.9, 1.9):
            bench = list(box((side * (half[0] - 0.5), y, 0), (0.5, 1.4, 0.45), 0))
            parts += stock.surfaces(bench, (DIFFUSE, pat.wood(OAK, 0.12)))
    sky = 6 * panorama("overcast", np.array(GROUND), rng)
    return _inside("chapel", stock, parts, half, height, (0.0, 0.0, 0.8), sky)


def _inside(
    name: str,
    stock: Stock,
    parts: list[Surface],
    half: tuple[float, float],
    height: float,
    target: Vector,
    sky: np.ndarray | None = None,
) -> Place:
    """The place with its lamps, and day outside."""
    rng, radiance = stock.rng, between(stock.rng, LAMPS)
    for x in (-0.45 * half[0], 0.45 * half[0]):
        for y in (-0.45 * half[1], 0.45 * half[1]):
            parts.append(built.lamp((x, y, height - 0.03), between(rng, (0.7, 1.2)), 0.9, radiance))
    outside = 2.5 * panorama(one_of(rng, DAYLIGHT), np.array(GROUND), rng) if sky is None else sky
    near = min(half)
    return Place(name, parts, outside, target, (1.35, near - 0.35), (0.9, min(2.0, height - 0.5)), half)


def _shell(stock: Stock, half: tuple[float, float], height: float, floor: Finish) -> list[Surface]:
    """Floor and ceiling."""
    width, depth = 2 * half[0] + 0.04, 2 * half[1] + 0.04
    lid = built.ceiling(width, depth, height)
    above = pat.plaster(stock.white) if stock.rng.uniform() < 0.6 else pat.wood((0.6, 0.46, 0.32), 0.25)
    return [
        stock.surface(built.flat((0, 0, 0), width, depth), floor, stock.thing()),
        stock.surface(lid, (DIFFUSE, above), stock.thing()),
    ]


def _floor(stock: Stock, name: str) -> Finish:
    rng = stock.rng
    choices = (
        pat.wood(OAK, 0.16),
        pat.wood((0.35, 0.22, 0.14), 0.12),
        pat.checkered((0.85, 0.83, 0.78), (0.2, 0.2, 0.22), 0.5),
        pat.slabs([stock.white, (0.6, 0.58, 0.54)], 0.6),
        pat.terrazzo((0.75, 0.73, 0.7), [stock.color(), stock.color(), stock.black, stock.white]),
        pat.concrete((0.5, 0.5, 0.5)),
    )
    pattern = choices[int(rng.integers(len(choices)))]
    if rng.uniform() >= POLISHED_FLOOR[name]:
        return DIFFUSE, pattern
    return built.polished(stock, between(rng, FLOOR_ROUGHNESS)), pattern


def _wallpaper(stock: Stock) -> pat.Pattern:
    first, second = stock.color(), stock.white
    pale = pat.blend(first, second, 0.5)
    choices = (
        pat.plaster(pale),
        lambda x, y, rng: pat.tex.weathered(pat.tex.stripes(x, y, 0, 0.3, (pale, second)), rng),
        lambda x, y, rng: pat.tex.weathered(pat.tex.harlequin(x, y, 0.35, 0.55, (pale, second, second)), rng),
        pat.brick((0.6, 0.34, 0.26), (0.75, 0.72, 0.68)),
        pat.wood((0.62, 0.5, 0.36), 0.2),
    )
    return choices[int(stock.rng.integers(len(choices)))]


def _wooden(stock: Stock) -> Finish:
    """Of a table: lacquered in as many scenes as things shine."""
    coated = stock.rng.uniform() < 0.6 * stock.shining
    color = (OAK, (0.3, 0.18, 0.12), (0.72, 0.58, 0.4))[int(stock.rng.integers(3))]
    return built.polished(stock, between(stock.rng, FLOOR_ROUGHNESS)) if coated else DIFFUSE, pat.wood(color, 0.14)


def _along(stock: Stock, walls: list[Wall]) -> list[Surface]:
    """Bookshelf, cupboard, sofa, pictures or a mirror, a lamp and a plant, along the walls."""
    rng, parts = stock.rng, []
    wooden = _wooden(stock)
    shelf = (between(rng, (1.2, 2.0)), 0.3, between(rng, (1.7, 2.1)))
    parts += built.against(stock, walls[1], between(rng, (-1, 1)), shelf, wooden, (DIFFUSE, pat.books))
    right = between(rng, (-0.6, 0.6))
    parts += built.against(stock, walls[2], right, (between(rng, (1.2, 1.8)), 0.42, 0.75), wooden, stock.finish())
    mirrored = rng.uniform() < WALL_MIRROR["room"]
    shown: Finish = (MIRROR, None) if mirrored else (DIFFUSE, pat.canvas(stock.colors))
    parts += built.hung(stock, walls[2], (right - 0.7, 1.0, right + 0.7, 2.0), shown, pat.plaster(stock.black))
    for at in (-1.1, 1.0):
        frame = (at - 0.35, 1.1, at + 0.35, 1.9)
        parts += built.hung(stock, walls[3], frame, (DIFFUSE, pat.canvas(stock.colors)), pat.plaster(OAK))
    parts += _sofa(stock, walls[3])
    x, y, _ = walls[0].at(walls[0].length / 2 - 0.45, 0, 0.4)
    parts += plant(stock, (float(x), float(y), 0.0), 0.42)
    x, y, _ = walls[2].at(walls[2].length / 2 - 0.4, 0, 0.35)
    foot = stock.surfaces([Rod((x, y, 0), (x, y, 1.4), 0.025), Disc((x, y, 0.02), 0.16)], stock.finish())
    shade = Lathe((float(x), float(y), 1.35), ((0.1, 0.35), (0.17, 0.15), (0.24, 0.0)))
    glow = Surface(shade, DIFFUSE, np.array([1, 0.85, 0.6]).reshape(1, 1, 3), stock.thing(), between(rng, (1, 3)))
    return [*parts, *foot, glow]


def _sofa(stock: Stock, wall: Wall) -> list[Surface]:
    finish: Finish = (DIFFUSE, pat.weave([stock.color(), stock.color()], 0.4))
    wide, turn = between(stock.rng, (1.4, 1.9)), wall.turn_degrees()
    seat, back = wall.at(0, 0.25, 0.42), wall.at(0, 0.5, 0.16)
    shapes = [
        Superellipsoid(built.vector(seat), (wide / 2, 0.38, 0.22), 8, turn),
        Superellipsoid(built.vector(back), (wide / 2, 0.13, 0.42), 8, turn),
    ]
    for side in (-1, 1):
        arm = wall.at(side * wide / 2, 0.33, 0.42)
        shapes.append(Superellipsoid(built.vector(arm), (0.1, 0.38, 0.3), 8, turn))
    return stock.surfaces(shapes, finish)


def _chairs(stock: Stock) -> list[Surface]:
    """Two or three stools about the table."""
    finish: Finish = (DIFFUSE, pat.wood((0.45, 0.3, 0.18), 0.08))
    parts = []
    for angle in stock.rng.uniform(0, 6.28) + np.arange(whole(stock.rng, (1, 3))) * 2.1:
        x, y = 1.0 * np.cos(angle), 1.0 * np.sin(angle)
        parts += built.table(stock, (float(x), float(y), 0.0), (0.34, 0.34, 0.44), finish, float(np.degrees(angle)))
    return parts


def _on_plinth(stock: Stock, x: float, y: float) -> list[Surface]:
    """A sculpture at breast height; now and then in a showcase of glass."""
    rng, tall = stock.rng, between(stock.rng, (0.45, 0.85))
    plinth = list(box((x, y, 0), (0.42, 0.42, tall), 0))
    parts = stock.surfaces(plinth, (DIFFUSE, pat.plaster(stock.white if rng.uniform() < 0.6 else stock.black)))
    thing = (knot, stone, figure, vase)[int(rng.integers(4))]
    parts += thing(stock, (x, y, tall), between(rng, (0.2, 0.28)))
    if rng.uniform() < SHOWCASE:
        parts += stock.surfaces(list(box((x, y, tall), (0.62, 0.62, 0.75), 0)), (PANE, None))
    return parts
