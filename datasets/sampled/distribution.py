"""The distribution that sampled scenes are drawn from: every share and every range, and how they are drawn.

A change of any number here makes other scenes of the same seeds: raise `source.VERSION` with it. World units are
meters, more or less: a tabletop is drawn as large as a table in a room, so that one scale of cameras does for all.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

Range = tuple[float, float]

# Places, and the light that falls on them
PLACES = {
    "room": 0.20,
    "gallery": 0.12,
    "chapel": 0.07,
    "tabletop": 0.19,
    "courtyard": 0.15,
    "plaza": 0.11,
    "vehicle": 0.09,
    "pond": 0.07,
}
DAYLIGHT = {"clear": 0.30, "broken": 0.25, "overcast": 0.25, "low_sun": 0.20}
TABLE_LIGHT = {"studio": 0.40, "hall": 0.25, "overcast": 0.15, "broken": 0.20}  # what a tabletop or an object stands in
HORIZONS = {"hills": 0.35, "houses": 0.40, "trees": 0.25}
SUN_ELEVATION: dict[str, Range] = {"clear": (25, 65), "broken": (20, 60), "low_sun": (8, 22)}  # degrees
SUN_SHARE: dict[str, Range] = {"clear": (1.0, 3.0), "broken": (0.4, 1.2), "low_sun": (1.0, 2.5)}  # of the sky's light
LAMPS: Range = (3.0, 8.0)  # radiance of a room's lamps
BRIGHT_PERCENTILE = 80  # of all pixels: the bright parts of the pictures
BRIGHT: Range = (0.30, 0.60)  # their linear light

# Materials of things. A scene's share of things that shine is drawn first: some have none, some little else.
NOTHING_SHINES = 0.12
SHINING: Range = (0.15, 0.9)
MATERIALS = {
    "satin": 0.14,
    "lacquer": 0.20,
    "varnish": 0.10,
    "car_paint": 0.08,
    "smooth_metal": 0.26,
    "brushed_metal": 0.16,
    "glass": 0.06,
}
METALS = {"Ag": 0.25, "Al": 0.15, "Cr": 0.25, "Au": 0.20, "Cu": 0.15}
ROUGHNESS: dict[str, Range] = {"satin": (0.45, 0.65), "varnish": (0.15, 0.35), "brushed_metal": (0.2, 0.5)}
COAT: Range = (1.4, 1.65)  # index of refraction

# What the large surfaces are of
POLISHED_FLOOR = {"room": 0.3, "gallery": 0.5, "chapel": 0.7, "courtyard": 0.15, "plaza": 1.0}
DARK_PLAZA: Range = (0.08, 0.5)  # how bright a plaza's slabs are, of their color
FLOOR_ROUGHNESS: Range = (0.0, 0.25)  # of a polished floor; below 0.08 it is smooth
WALL_MIRROR = {"room": 0.35, "gallery": 0.45}
SHOWCASE = 0.3  # of galleries have one of glass
THINGS = {
    "room": (3, 6),
    "gallery": (3, 5),
    "chapel": (4, 7),
    "tabletop": (5, 11),
    "courtyard": (3, 6),
    "plaza": (4, 8),
}

# Cameras
WALKS = {"orbit": 0.30, "half_orbit": 0.20, "hand_held": 0.22, "uneven": 0.16, "few": 0.12}
FIELD_OF_VIEW: Range = (50, 68)  # degrees, horizontal
HALF_ORBIT: Range = (130, 210)  # degrees
HAND_HELD: Range = (150, 360)
FEW: Range = (0.2, 0.4)  # of the views asked for
CLEARANCE = 0.3  # between a camera and the nearest surface

# Points as structure from motion leaves them
POINTS: Range = (2500, 7000)
POINT_NOISE: Range = (0.5, 1.5)  # of a pixel, across the line of sight; along it, as parallax makes of that
ON_SHINING: Range = (0.05, 0.4)  # of a point's chance where a coat or a rough metal is; on mirrors and glass a third
VIRTUAL: Range = (0.0, 0.5)  # of the points looked for on mirrors that are found where the image is, behind them
OUTLIERS: Range = (0.0, 0.04)  # of the points: anywhere
ON_SKY: Range = (0, 250)  # points

# Normals as estimators give them
NORMALS_OFF: Range = (3.0, 11.0)  # mean angle of what varies smoothly, degrees
NORMALS_BLUR: Range = (0.004, 0.012)  # of the picture's width
MIRRORS_TAKEN_FOR_ROOMS: Range = (0.0, 0.6)  # how far the normals of mirrors are those of what they show


def between(rng: np.random.Generator, limits: Range) -> float:
    return float(rng.uniform(*limits))


def whole(rng: np.random.Generator, limits: Range) -> int:
    """A whole number in `limits`, both included."""
    return int(rng.integers(int(limits[0]), int(limits[1]) + 1))


def one_of(rng: np.random.Generator, shares: Mapping[str, float]) -> str:
    """A key, as likely as its value says beside the others'."""
    values = np.array(list(shares.values()))
    return list(shares)[int(rng.choice(len(values), p=values / values.sum()))]
