"""Patterns: what sampled surfaces are painted with: [H, W, 3] sRGB in [0, 1], by x to the right and y down, meters."""

from __future__ import annotations

import colorsys
from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from ..toy import textures as tex
from ..toy.textures import Array

Color = tuple[float, float, float]
Pattern = Callable[[Array, Array, np.random.Generator], Array]

MOST_TEXELS = 900  # along an edge


def picture(pattern: Pattern, extent: tuple[float, float], rng: np.random.Generator) -> Array:
    """The pattern over a surface of that width and height, at the toys' density or as dense as may be."""
    density = min(tex.TEXELS_PER_METER, MOST_TEXELS / max(extent))
    columns, rows = (max(4, round(edge * density)) for edge in extent)
    x, y = np.meshgrid((np.arange(columns) + 0.5) / density, (np.arange(rows) + 0.5) / density)
    return np.clip(pattern(x, y, rng), 0, 1)


def palette(rng: np.random.Generator, count: int = 6) -> list[Color]:
    """Colors that go together: neighbors of one hue, one opposite, light and dark neutrals among them."""
    hue, found = rng.uniform(), []
    for index in range(count):
        own = hue + rng.normal(0, 0.06) + (0.5 if index % 3 == 2 else 0)
        saturation, value = rng.uniform(0.25, 0.85), rng.uniform(0.35, 0.9)
        found.append(colorsys.hsv_to_rgb(own % 1, saturation, value))
    warm = rng.uniform(-0.03, 0.05)
    return [*found, (0.9 + warm, 0.89, 0.86 - warm), (0.16 + warm, 0.15, 0.15)]


def blend(first: Color, second: Color, share: float) -> Color:
    """The first color with that share of the second."""
    red, green, blue = ((1 - share) * a + share * b for a, b in zip(first, second, strict=True))
    return red, green, blue


def _noise(x: Array, cell: float, rng: np.random.Generator, octaves: int = 4) -> Array:
    """Fractal noise in about [−1, 1]; the largest blobs span `cell` meters."""
    spacing = x[0, 1] - x[0, 0]
    return tex.noise(x.shape, max(cell / spacing, 1.5), rng, octaves)


def _shaded(color: Color | Array, shade: Array) -> Array:
    return np.asarray(color) * shade[..., None]


def _cells(x: Array, y: Array, size: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Of irregular cells of about that size: each texel's cell, and 0 at its border, growing inward, in meters."""
    width, height = x.max() + size, y.max() + size
    count = int(np.clip(width * height / size**2, 4, 20000))
    seeds = rng.uniform((-size / 2, -size / 2), (width, height), (count, 2))
    distance, index = cKDTree(seeds).query(np.stack([x, y], -1).reshape(-1, 2), k=2)
    return index[:, 0].reshape(x.shape), (distance[:, 1] - distance[:, 0]).reshape(x.shape) / 2


def plaster(color: Color) -> Pattern:
    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        return _shaded(color, 1 + 0.10 * _noise(x, 1.2, rng, 6) + 0.05 * rng.uniform(-1, 1, x.shape))

    return drawn


def concrete(color: Color) -> Pattern:
    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        slab = np.where((x % 1.5 < 0.012) | (y % 1.5 < 0.012), 0.6, 1.0)
        return _shaded(color, slab * (1 + 0.2 * _noise(x, 0.9, rng, 7) + 0.06 * rng.uniform(-1, 1, x.shape)))

    return drawn


def brick(color: Color, mortar: Color) -> Pattern:
    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        row = np.floor(y / 0.09).astype(int)
        along = x + 0.125 * (row % 2)
        column = np.floor(along / 0.25).astype(int)
        shade = rng.uniform(0.65, 1.2, (row.max() + 1, column.max() + 1))[row, column]
        wall = _shaded(color, shade * (1 + 0.15 * _noise(x, 0.05, rng, 3)))
        joint = (y % 0.09 < 0.012) | (along % 0.25 < 0.012)
        wall[joint] = mortar
        return wall * (1 + 0.15 * _noise(x, 1.5, rng))[..., None]

    return drawn


def slabs(colors: list[Color], size: float) -> Pattern:
    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        row, column = np.floor(y / size).astype(int), np.floor(x / size).astype(int)
        pick = rng.integers(0, len(colors), (row.max() + 1, column.max() + 1))[row, column]
        shade = rng.uniform(0.85, 1.1, (row.max() + 1, column.max() + 1))[row, column]
        floor = _shaded(np.array(colors)[pick], shade * (1 + 0.18 * _noise(x, 0.3, rng, 5)))
        floor[(x % size < 0.02 * size + 0.006) | (y % size < 0.02 * size + 0.006)] *= 0.45
        return floor

    return drawn


def checkered(first: Color, second: Color, size: float) -> Pattern:
    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        return marble_of(tex.checker(x, y, size, (first, second)), x, rng)

    return drawn


def marble_of(base: Array, x: Array, rng: np.random.Generator) -> Array:
    """The picture with veins."""
    veins = np.exp(-np.abs(_noise(x, 0.8, rng, 6)) / 0.04)
    return base * (1 - 0.35 * veins + 0.12 * _noise(x, 0.5, rng, 5))[..., None]


def marble(color: Color) -> Pattern:
    return lambda x, y, rng: marble_of(tex.plain(x, color), x, rng)


def wood(color: Color, width: float) -> Pattern:
    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        row = np.floor(y / width).astype(int)
        shade = rng.uniform(0.75, 1.2, row.max() + 1)[row]
        warp = _noise(x, 0.5, rng, 3)
        fibers = np.sin(2 * np.pi * (y / width * 5 + 1.4 * warp)) * 0.5 + _noise(x, 0.03, rng, 2)
        seam = np.where(y / width - row < 0.03, 0.5, 1.0)
        return _shaded(color, shade * seam * (1 + 0.16 * fibers))

    return drawn


def terrazzo(base: Color, chips: list[Color]) -> Pattern:
    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        cell, inward = _cells(x, y, 0.07, rng)
        floor = tex.plain(x, base)
        chip = inward > 0.008
        floor[chip] = np.array(chips)[cell[chip] % len(chips)]
        return floor * (1 + 0.08 * _noise(x, 0.6, rng))[..., None]

    return drawn


def cobbles(color: Color, size: float) -> Pattern:
    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        cell, inward = _cells(x, y, size, rng)
        shade = rng.uniform(0.6, 1.15, int(cell.max()) + 1)[cell] * np.clip(inward / (0.12 * size), 0.35, 1)
        return _shaded(color, shade * (1 + 0.12 * _noise(x, 0.1, rng)))

    return drawn


def grass(color: Color) -> Pattern:
    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        blades = rng.uniform(0.55, 1.3, x.shape) * (1 + 0.3 * _noise(x, 0.08, rng, 3))
        tint = np.array(color) + 0.06 * _noise(x, 1.4, rng)[..., None] * np.array([1, 0.3, -0.3])
        return tint * blades[..., None]

    return drawn


def asphalt(color: Color, line: Color) -> Pattern:
    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        road = _shaded(color, rng.uniform(0.7, 1.3, x.shape) * (1 + 0.25 * _noise(x, 1.0, rng, 6)))
        middle = y - y.mean()
        painted = ((np.abs(np.abs(middle) - 1.9) < 0.06) | ((np.abs(middle - 3.4) < 0.05) & (x % 1.5 < 0.9))) & (
            _noise(x, 0.3, rng) > -0.45
        )
        road[painted] = line
        return road

    return drawn


def weave(colors: list[Color], size: float) -> Pattern:
    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        threads = 0.85 + 0.15 * np.sin(2 * np.pi * x / 0.025) * np.sin(2 * np.pi * y / 0.025)
        column, row = np.floor(x / size).astype(int), np.floor(y / size).astype(int)
        plaid = (np.array(colors)[column % len(colors)] + np.array(colors)[row % len(colors)]) / 2
        return plaid * (threads * (1 + 0.1 * _noise(x, 0.4, rng)))[..., None]

    return drawn


def rug(colors: list[Color]) -> Pattern:
    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        edge = np.minimum(np.minimum(x, x.max() - x), np.minimum(y, y.max() - y))
        cell = rng.uniform(0.15, 0.35)
        field = tex.harlequin(x, y, cell, 1.3 * cell, tuple(colors[:3]))
        for limit, color in ((0.30, colors[3]), (0.22, colors[4]), (0.10, colors[0]), (0.04, colors[-1])):
            field[edge < limit] = color
        return field * (1 + 0.12 * _noise(x, 0.05, rng, 2))[..., None]

    return drawn


def printed(paper: Color, ink: Color) -> Pattern:
    """A box or a tin with a band of writing."""

    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        size = max(y.max() / 5, 0.03)
        label = tex.glyphs(x, y, size, (ink,), paper, rng)
        label[(y < 0.12 * y.max()) | (y > 0.88 * y.max())] = ink
        return label * (1 + 0.1 * _noise(x, 0.2, rng))[..., None]

    return drawn


def glaze(first: Color, second: Color) -> Pattern:
    """Pottery: bands around, or a glaze that has run."""

    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        line = (0.3 + 0.4 * rng.uniform()) * y.max() + 0.15 * y.max() * _noise(x, 0.3 * x.max(), rng, 5)
        pot = np.where((y < line)[..., None], np.array(first), np.array(second))
        if rng.uniform() < 0.5:
            pot[(y % (y.max() / 5)) < 0.05 * y.max()] = second
        return pot * (1 + 0.12 * _noise(x, 0.1, rng))[..., None]

    return drawn


def canvas(colors: list[Color]) -> Pattern:
    """A painting: a landscape of bands, or an abstract one of patches; in a frame."""

    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        if rng.uniform() < 0.5:
            height = y / y.max() + 0.12 * _noise(x, 0.6 * x.max(), rng, 5)
            art = np.array(colors)[np.clip((height * len(colors)).astype(int), 0, len(colors) - 1)]
        else:
            cell, _ = _cells(x, y, 0.25 * min(x.max(), y.max()), rng)
            art = np.array(colors)[cell % len(colors)]
        art = art * (1 + 0.2 * _noise(x, 0.1, rng, 4))[..., None]
        return tex.framed(art, colors[-1], 0.05) if min(x.shape) > 16 else art

    return drawn


def books(x: Array, y: Array, rng: np.random.Generator) -> Array:
    return tex.weathered(tex.bookshelf(x, y, 0.42, rng), rng)


def leaded(colors: list[Color]) -> Pattern:
    """Stained glass: panes of color between cames of lead."""

    def drawn(x: Array, y: Array, rng: np.random.Generator) -> Array:
        cell, inward = _cells(x, y, 0.22, rng)
        window = np.array(colors)[cell % len(colors)] ** 0.7
        window[inward < 0.012] = 0.02
        return window

    return drawn
