"""Light: the panoramas that sampled places lie under, [ROWS, COLUMNS, 3] linear radiance from infinity.

Row 0 looks to +z, columns run counterclockwise from +x. Their mean over the upper half is about 1; pictures are exposed
to what they show.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from ..formats.srgb import to_linear
from ..toy.textures import Array, noise
from .distribution import HORIZONS, SUN_ELEVATION, SUN_SHARE, between, one_of

ROWS, COLUMNS = 384, 768
SUN_RADIUS = 1.3  # degrees

# zenith, horizon: sRGB
AIR = {
    "clear": ((0.22, 0.42, 0.80), (0.72, 0.82, 0.92)),
    "broken": ((0.30, 0.48, 0.80), (0.80, 0.84, 0.90)),
    "overcast": ((0.78, 0.80, 0.84), (0.88, 0.88, 0.88)),
    "low_sun": ((0.28, 0.36, 0.62), (0.98, 0.78, 0.55)),
}


def panorama(kind: str, ground: Array, rng: np.random.Generator) -> Array:
    """Of a key of DAYLIGHT, or `studio` or `hall`, which are indoors.

    Args:
        ground: [3] linear, the color below the horizon, out of doors.
    """
    elevation = np.broadcast_to((np.pi * (0.5 - (np.arange(ROWS) + 0.5) / ROWS))[:, None], (ROWS, COLUMNS))
    azimuth = np.broadcast_to((2 * np.pi * (np.arange(COLUMNS) + 0.5) / COLUMNS)[None], (ROWS, COLUMNS))
    if kind == "studio":
        return _studio(elevation, azimuth, rng)
    if kind == "hall":
        return _hall(elevation, azimuth, rng)
    return _outdoors(kind, np.asarray(ground), elevation, azimuth, rng)


def _outdoors(kind: str, ground: Array, elevation: Array, azimuth: Array, rng: np.random.Generator) -> Array:
    zenith, horizon = (to_linear(np.array(color)) for color in AIR[kind])
    up = np.sin(np.maximum(elevation, 0))[..., None]
    sky: Array = zenith * up**0.6 + horizon * (1 - up**0.6)
    direction = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    sky = _clouded(sky, kind, direction, rng)
    if kind in SUN_ELEVATION:
        sky = sky + _sun(kind, sky, direction, rng)
    sky = _behind_horizon(sky, horizon, elevation, azimuth, rng)
    far = np.exp(-np.maximum(-elevation, 0) / 0.06)[..., None]
    field = ground * (1 + 0.35 * noise((ROWS, COLUMNS), 24, rng, octaves=5, wrap=True)[..., None])
    return np.where((elevation < 0)[..., None], 0.35 * field * (1 - far) + 0.35 * horizon * far, sky)


def _clouded(sky: Array, kind: str, direction: Array, rng: np.random.Generator) -> Array:
    """With a layer of clouds in perspective: thick, broken or thin."""
    cover = {"clear": -0.35, "broken": 0.12, "overcast": 0.9, "low_sun": 0.0}[kind] + rng.normal(0, 0.08)
    rise = np.maximum(direction[2], 0) + 0.18
    x, y = (256 + 50 * direction[axis] / rise for axis in (0, 1))
    layer = noise((512, 512), 60, rng, octaves=6)
    clumps = ndimage.map_coordinates(layer, [y, x], order=1, mode="reflect")
    share = np.clip(2.4 * (clumps + cover), 0, 1)[..., None]
    shade = np.clip(1.15 - 0.5 * clumps - 0.25 * cover, 0.4, 1.4)[..., None]
    tint = np.array((1.0, 0.86, 0.74)) if kind == "low_sun" else np.array((1.0, 0.99, 0.97))
    return sky * (1 - share) + 0.85 * tint * shade * share


def _sun(kind: str, sky: Array, direction: Array, rng: np.random.Generator) -> Array:
    """A disc that gives `SUN_SHARE` of the light that the sky gives, with its glow."""
    height, around = np.radians(between(rng, SUN_ELEVATION[kind])), rng.uniform(0, 2 * np.pi)
    toward = np.array([np.cos(height) * np.cos(around), np.cos(height) * np.sin(around), np.sin(height)])
    cosine = np.einsum("i,ihw->hw", toward, direction)
    disc = (cosine > np.cos(np.radians(SUN_RADIUS))).astype(float)
    texel = np.cos(np.arcsin(np.clip(direction[2], -1, 1))) * (np.pi / ROWS) ** 2
    upward = np.maximum(direction[2], 0) * texel
    level = (sky.mean(-1) * upward).sum()
    own = max(float((disc * upward).sum()), 1e-9)
    color = np.array((1.0, 0.72, 0.42)) if kind == "low_sun" else np.array((1.0, 0.95, 0.86))
    glow = 0.8 * np.exp((cosine - 1) * 30)
    return (between(rng, SUN_SHARE[kind]) * level / own * disc + glow)[..., None] * color


def _behind_horizon(sky: Array, horizon: Array, elevation: Array, azimuth: Array, rng: np.random.Generator) -> Array:
    """With hills, houses or trees standing before it, the nearer the darker."""
    kind = one_of(rng, HORIZONS)
    for layer in range(3):
        near = (layer + 1) / 3
        ridge: Array = 0.10 * (1 - 0.55 * layer / 2) * (1 + noise((2, COLUMNS), 90, rng, octaves=5, wrap=True)[0])
        color: Array = to_linear(np.array(((0.34, 0.42, 0.50), (0.27, 0.36, 0.26), (0.17, 0.24, 0.13))[layer]))
        shade: Array = np.ones((ROWS, COLUMNS))
        if kind == "houses" and layer:
            width = rng.integers(14, 40)
            block = (np.arange(COLUMNS) // width).astype(int)
            ridge = rng.uniform(0.04, 0.30 if layer == 1 else 0.16, block.max() + 1)[block]
            color = np.array([0.9, 0.8, 0.7]) * rng.uniform(0.15, 0.55, (block.max() + 1, 1))[block][None]
            window = (np.arange(COLUMNS) % 7 > 3)[None] & ((elevation * 90).astype(int) % 4 > 1)
            shade = np.where(window, 0.55, 1.0)
        elif kind == "trees" and layer == 2:
            ridge = ridge + 0.10 * np.abs(noise((2, COLUMNS), 16, rng, octaves=5, wrap=True)[0])
            shade = 1 + 0.6 * noise((ROWS, COLUMNS), 8, rng, octaves=3, wrap=True)
        hidden = (elevation < ridge[None]) & (elevation > -0.05)
        painted = np.broadcast_to(color, sky.shape) * np.clip(shade, 0.2, 2)[..., None]
        hazy = painted * near + 0.5 * horizon * (1 - near)
        sky = np.where(hidden[..., None], hazy, sky)
    return sky


def _studio(elevation: Array, azimuth: Array, rng: np.random.Generator) -> Array:
    """A dim backdrop of some color, with two to four soft boxes and strips."""
    dim = to_linear(np.array([0.45, 0.45, 0.47]) * rng.uniform(0.7, 1.3) + rng.normal(0, 0.04, 3))
    room = dim * (0.6 + 0.5 * np.sin(elevation))[..., None]
    room = room * (1 + 0.2 * noise((ROWS, COLUMNS), 60, rng, octaves=5, wrap=True)[..., None])
    for _ in range(int(rng.integers(2, 5))):
        at, height = rng.uniform(0, 2 * np.pi), rng.uniform(0.2, 1.1)
        wide, tall = rng.uniform(0.12, 0.6), rng.uniform(0.12, 0.45)
        away = np.abs(np.angle(np.exp(1j * (azimuth - at))))
        box = (away < wide) & (np.abs(elevation - height) < tall)
        grid = (away < 0.012) | (np.abs(elevation - height) < 0.012)
        room[box & ~grid] = rng.uniform(4, 10) * np.array([1, 0.97, 0.93])
    return np.maximum(room, 0)


def _hall(elevation: Array, azimuth: Array, rng: np.random.Generator) -> Array:
    """A large room far around: walls with windows, pictures and shelves between dark floor and ceiling with lamps."""
    wall = to_linear(np.array([0.62, 0.55, 0.46]) * rng.uniform(0.6, 1.1) + rng.normal(0, 0.05, 3))
    room = wall * (1 + 0.2 * noise((ROWS, COLUMNS), 40, rng, octaves=5, wrap=True)[..., None])
    bays = int(rng.integers(8, 15))
    bay = np.floor(azimuth / (2 * np.pi) * bays).astype(int)
    inside = np.abs(azimuth / (2 * np.pi) * bays - bay - 0.5)
    use, tint = rng.integers(0, 3, bays)[bay], rng.uniform(0.05, 0.8, (bays, 3))[bay]
    panel = (inside < 0.34) & (elevation > -0.12) & (elevation < 0.55)
    bars = (inside % 0.11 < 0.012) | ((elevation + 1) % 0.16 < 0.012)
    room[panel & (use == 0) & ~bars] = rng.uniform(3, 7) * np.array([0.95, 1.0, 1.08])
    room[panel & (use == 1)] = (tint * (0.5 + 0.5 * (np.sin(40 * azimuth + 9 * elevation) > 0))[..., None])[
        panel & (use == 1)
    ]
    spine = rng.uniform(0.02, 0.6, (COLUMNS // 3 + 1, 3))[(np.arange(COLUMNS) // 3)]
    shelf = panel & (use == 2)
    room[shelf] = np.broadcast_to(spine[None], room.shape)[shelf]
    room[shelf & ((elevation + 1) % 0.13 < 0.02)] = 0.05
    floor, ceiling = elevation < -0.3, elevation > 0.75
    room[floor] = (0.4 * wall * (0.7 + 0.3 * np.sign(np.sin(24 * azimuth)))[..., None])[floor]
    room[ceiling] = 1.1 * wall
    room[ceiling & (np.sin(6 * azimuth) > 0.75) & (elevation < 1.15)] = 6.0
    return np.maximum(room, 0)
