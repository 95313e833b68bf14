"""Procedural pictures for the toy scenes' surfaces: [H, W, 3] float arrays, sRGB-encoded, in [0, 1].

All have edges at several scales, so that structure from motion would find them and a blurred reflection shows.
`TEXELS_PER_METER` texels cover one world unit, a meter; the pictures take sizes in world units.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]
Color = tuple[float, float, float]

TEXELS_PER_METER = 128

INK: Color = (0.10, 0.10, 0.16)
CREAM: Color = (0.95, 0.91, 0.81)
TEAL: Color = (0.05, 0.44, 0.47)
SKY: Color = (0.33, 0.66, 0.86)
VERMILION: Color = (0.88, 0.30, 0.17)
MUSTARD: Color = (0.95, 0.71, 0.18)
GREEN: Color = (0.30, 0.60, 0.35)
PLUM: Color = (0.48, 0.16, 0.38)
OAK: Color = (0.55, 0.36, 0.20)
SLATE: Color = (0.28, 0.31, 0.36)
VIVID = (VERMILION, MUSTARD, TEAL, SKY, GREEN, PLUM, CREAM, INK)


def grid(width: float, height: float) -> tuple[Array, Array]:
    """x to the right and y down, in world units, at the texel centers of a width × height picture: [H, W] each."""
    columns, rows = max(1, round(width * TEXELS_PER_METER)), max(1, round(height * TEXELS_PER_METER))
    y, x = np.meshgrid(
        (np.arange(rows) + 0.5) / TEXELS_PER_METER, (np.arange(columns) + 0.5) / TEXELS_PER_METER, indexing="ij"
    )
    return x, y


def paint(picture: Array, where: NDArray[np.bool_], color: Color | Array) -> None:
    """Colors the texels inside the [H, W] bool mask."""
    picture[where] = color


def plain(x: Array, color: Color) -> Array:
    return np.broadcast_to(np.array(color), (*x.shape, 3)).copy()


def choose(index: NDArray[np.int64], palette: tuple[Color, ...]) -> Array:
    """The palette's color for each integer of [H, W], repeating."""
    return np.array(palette)[index % len(palette)]


def noise(shape: tuple[int, ...], cell: float, rng: np.random.Generator, octaves: int = 4, wrap: bool = False) -> Array:
    """Fractal value noise [H, W] in about [−1, 1]; the largest blobs span `cell` texels; `wrap` makes u periodic."""
    total = np.zeros(shape)
    for octave in range(octaves):
        spacing = max(cell / 2**octave, 1.0)
        rows, columns = int(shape[0] / spacing) + 2, int(shape[1] / spacing) + 2
        if wrap:
            columns = max(1, round(shape[1] / spacing))
        step = columns / shape[1] if wrap else 1 / spacing
        lattice = rng.uniform(-1, 1, (rows, columns))
        down = linear_weights(np.arange(shape[0]) / spacing, rows)
        across = linear_weights(np.arange(shape[1]) * step, columns, wrap)
        total += (down @ lattice @ across.T) / 2**octave
    return total / 1.5


def linear_weights(positions: Array, count: int, wrap: bool = False) -> Array:
    """[P, count]: the matrix that interpolates `count` samples linearly at `positions`, clamped or periodic."""
    if not wrap:
        positions = np.clip(positions, 0, count - 1)
    distance = np.abs(positions[:, None] - np.arange(count))
    if wrap:
        distance = np.minimum(distance, count - distance)
    return np.maximum(0, 1 - distance)


def weathered(picture: Array, rng: np.random.Generator, amount: float = 0.12) -> Array:
    """The picture with grain and stains, which give even a plain color something to match."""
    stain = noise(picture.shape[:2], 0.5 * TEXELS_PER_METER, rng, octaves=5)
    grain = rng.uniform(-0.2, 0.2, picture.shape[:2])
    return np.clip(picture * (1 + amount * (stain + grain))[..., None], 0, 1)


def checker(x: Array, y: Array, cell: float, palette: tuple[Color, ...]) -> Array:
    return choose(np.floor(x / cell).astype(np.int64) + np.floor(y / cell).astype(np.int64), palette)


def stripes(x: Array, y: Array, angle_degrees: float, period: float, palette: tuple[Color, ...]) -> Array:
    """Bands of equal width across the direction `angle_degrees`; one palette a period."""
    along = x * np.cos(np.radians(angle_degrees)) + y * np.sin(np.radians(angle_degrees))
    return choose(np.floor(along / period * len(palette)).astype(np.int64), palette)


def harlequin(x: Array, y: Array, width: float, height: float, palette: tuple[Color, ...]) -> Array:
    """Diamonds, `width` by `height` each; takes three colors or more."""
    a, b = x / width + y / height, x / width - y / height
    return choose(np.floor(a).astype(np.int64) + 2 * np.floor(b).astype(np.int64), palette)


def rings(x: Array, y: Array, center: tuple[float, float], period: float, palette: tuple[Color, ...]) -> Array:
    radius = np.hypot(x - center[0], y - center[1])
    return choose(np.floor(radius / period).astype(np.int64), palette)


def sunburst(x: Array, y: Array, center: tuple[float, float], rays: int, palette: tuple[Color, ...]) -> Array:
    angle = np.arctan2(y - center[1], x - center[0]) / (2 * np.pi)
    return choose(np.floor(angle * rays).astype(np.int64), palette)


def tiles(x: Array, y: Array, cell: float, rng: np.random.Generator) -> Array:
    """Cement tiles: quarter circles at two opposite corners, turned at random (Truchet), a diamond in each middle."""
    column, row = np.floor(x / cell).astype(np.int64), np.floor(y / cell).astype(np.int64)
    turned = rng.integers(0, 2, (row.max() + 1, column.max() + 1))[row, column]
    s, t = x / cell - column, y / cell - row
    s = np.where(turned == 1, 1 - s, s)
    nearest = np.minimum(np.hypot(s, t), np.hypot(1 - s, 1 - t))
    picture = choose((row + column) % 2, (CREAM, (0.78, 0.84, 0.84)))
    paint(picture, nearest < 0.62, TEAL)
    paint(picture, nearest < 0.46, CREAM)
    paint(picture, nearest < 0.36, INK)
    paint(picture, nearest < 0.18, MUSTARD)
    paint(picture, abs(s - 0.5) + abs(t - 0.5) < 0.1, VERMILION)
    paint(picture, np.minimum(np.minimum(s, 1 - s), np.minimum(t, 1 - t)) < 0.02, SLATE)
    return picture


def planks(x: Array, y: Array, width: float, rng: np.random.Generator) -> Array:
    """Floor boards along x with grain, each of its own shade."""
    row = np.floor(y / width).astype(np.int64)
    shade = rng.uniform(0.7, 1.25, row.max() + 1)[row]
    grain = noise(x.shape, 0.12 * TEXELS_PER_METER, rng, octaves=3)
    fibers = np.sin(2 * np.pi * (y / width * 6 + 0.8 * grain))
    seam = np.where(np.abs(y / width - row - 0.5) > 0.47, 0.45, 1.0)
    return np.clip(np.array(OAK) * (shade * seam * (1 + 0.14 * fibers))[..., None], 0, 1)


def glyphs(x: Array, y: Array, size: float, ink: tuple[Color, ...], paper: Color, rng: np.random.Generator) -> Array:
    """Lines of block letters that spell nothing: mirror-symmetric 5×5 bitmaps in cells of size × 1.25·size."""
    column, row = np.floor(x / size).astype(np.int64), np.floor(y / (1.25 * size)).astype(np.int64)
    halves = rng.uniform(size=(row.max() + 1, column.max() + 1, 5, 3)) < 0.55
    bitmaps = np.concatenate([halves, halves[..., 1::-1]], axis=-1)
    s = np.floor((x / size - column) * 6 - 0.5).astype(np.int64)
    t = np.floor((y / (1.25 * size) - row) * 7.5 - 1.0).astype(np.int64)
    inside = (s >= 0) & (s < 5) & (t >= 0) & (t < 5)
    marked = inside & bitmaps[row, column, np.clip(t, 0, 4), np.clip(s, 0, 4)]
    letter_color = choose(rng.integers(0, len(ink), (row.max() + 1, column.max() + 1)), ink)[row, column]
    return np.where(marked[..., None], letter_color, np.array(paper))


def bookshelf(x: Array, y: Array, shelf: float, rng: np.random.Generator) -> Array:
    """Rows of book spines between boards `shelf` apart."""
    picture = plain(x, (0.16, 0.11, 0.08))
    height = x.shape[0] / TEXELS_PER_METER
    for index in range(int(np.ceil(height / shelf))):
        left, bottom = 0.0, (index + 1) * shelf - 0.03
        while left < x.max():
            width, tall = shelf * rng.uniform(0.12, 0.3), shelf * rng.uniform(0.6, 0.9)
            if rng.uniform() < 0.94:
                book = (slice(_texel(bottom - tall), _texel(bottom)), slice(_texel(left), _texel(left + width - 0.005)))
                picture[book] = np.array(VIVID[rng.integers(len(VIVID))]) * rng.uniform(0.65, 1.0)
                middle, half = bottom - tall * rng.uniform(0.15, 0.85), shelf * rng.uniform(0.03, 0.08)
                picture[_texel(middle - half) : _texel(middle + half), book[1]] = VIVID[rng.integers(len(VIVID))]
            left += width
        picture[_texel(bottom) : _texel(bottom + 0.03)] = OAK
    return picture


def _texel(length: float) -> int:
    return max(0, round(length * TEXELS_PER_METER))


def framed(picture: Array, color: Color, width: float = 0.04) -> Array:
    """The picture with a border of `width` world units painted over its edge."""
    border = max(1, round(width * TEXELS_PER_METER))
    result = plain(picture[..., 0], color)
    result[border:-border, border:-border] = picture[border:-border, border:-border]
    return result


def hang(wall: Array, poster: Array, left: float, top: float) -> None:
    """Copies the poster onto the wall, its upper left corner at (left, top) world units."""
    column, row = round(left * TEXELS_PER_METER), round(top * TEXELS_PER_METER)
    wall[row : row + poster.shape[0], column : column + poster.shape[1]] = poster
