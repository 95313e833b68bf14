"""A procedural panorama: clouds, a low sun, far hills and fields. Light from infinity."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..formats.srgb import to_linear
from .textures import choose, noise

Array = NDArray[np.floating[Any]]

ROWS, COLUMNS = 1024, 2048
SUN = np.array([0.70, 0.50, 0.42])
HORIZON = (0.80, 0.84, 0.92)
CROPS = ((0.42, 0.55, 0.22), (0.66, 0.64, 0.26), (0.84, 0.70, 0.34), (0.26, 0.42, 0.20), (0.58, 0.38, 0.24))


def panorama(rng: np.random.Generator) -> Array:
    """Radiance [1024, 2048, 3], linear; row 0 looks to +z, and columns run counterclockwise from +x."""
    elevation = np.pi * (0.5 - (np.arange(ROWS) + 0.5) / ROWS)[:, None]
    azimuth = (2 * np.pi * (np.arange(COLUMNS) + 0.5) / COLUMNS)[None, :]
    flat = np.cos(elevation)
    directions = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation) + 0 * azimuth], axis=-1)
    above, below = np.split(directions, 2)
    sky = np.concatenate([_air(above, rng), _fields(below, rng)])
    for height, roughness, cell, color in (
        (0.17, 0.09, 140, (0.60, 0.68, 0.84)),
        (0.09, 0.06, 90, (0.42, 0.53, 0.62)),
        (0.03, 0.03, 60, (0.25, 0.38, 0.34)),
    ):
        ridge = height + roughness * noise((2, COLUMNS), cell, rng, octaves=6, wrap=True)[0]
        sky[(elevation < ridge) & (elevation > -0.02)] = to_linear(color)
    return sky


def afternoon(rng: np.random.Generator) -> Array:
    """The panorama with everything, the sun too, a quarter further round."""
    sky = panorama(rng)
    return np.roll(sky, sky.shape[1] // 4, axis=1)


def _air(directions: Array, rng: np.random.Generator) -> Array:
    """Blue overhead, pale at the horizon, a sun with its glow, and a layer of clouds in perspective."""
    up = np.maximum(directions[..., 2], 0)
    pale = ((1 - up) ** 5)[..., None]
    air = to_linear(HORIZON) * pale + to_linear((0.16, 0.40, 0.78)) * (1 - pale)
    x, y = (256 + 55 * directions[..., i] / (up + 0.22) for i in (0, 1))
    clumps = ndimage.map_coordinates(noise((512, 512), 36, rng, octaves=6), [y, x], order=1, mode="reflect")
    cover = np.clip(2.6 * clumps + 0.25, 0, 1)[..., None]
    cloud = to_linear((1.0, 0.97, 0.94)) * (1.2 - 0.75 * np.clip(1.5 * clumps - 0.1, 0, 1)[..., None])
    toward_sun = directions @ (SUN / np.linalg.norm(SUN))
    glow = 1.5 * np.exp((toward_sun - 1) * 25) + 12.0 * (toward_sun > np.cos(np.radians(3.5)))
    return air * (1 - cover) + cloud * cover + glow[..., None] * np.array([1.0, 0.80, 0.50])


def _fields(directions: Array, rng: np.random.Generator) -> Array:
    """Patches of farmland on a plane far below, fading into haze toward the horizon."""
    down = np.maximum(-directions[..., 2], 0.02)
    x, y = directions[..., 0] / down, directions[..., 1] / down
    wobble = 0.3 * noise(directions.shape[:2], 60, rng, octaves=3, wrap=True)
    column, row = np.floor((x + wobble) * 1.6).astype(np.int64), np.floor((y - wobble) * 1.6).astype(np.int64)
    furrows = 1 + 0.15 * np.sign(np.sin(25 * (x + y * (column % 3 - 1))))
    shade = rng.uniform(0.8, 1.1, (97, 89))[row % 97, column % 89] * furrows
    field = choose(row * 7 + column * 3 + row * column, CROPS) * shade[..., None]
    haze = (1 - np.exp(-np.hypot(x, y) / 7))[..., None]
    return to_linear(np.clip(field, 0, 1)) * (1 - haze) + to_linear((0.62, 0.72, 0.78)) * haze
