"""`wavy_mirror`: mirrors whose normals turn from place to place."""

from __future__ import annotations

import numpy as np

from ...formats.srgb import to_linear
from .. import textures as tex
from ..shapes import box
from ..sky import panorama
from ..waves import Wave, Waves
from ..world import Part
from .description import Description, Orbit, painted
from .room import BLOCKS, blocks, walls

SIDE, FOOT, TOP = 1.2, 0.14, 1.6
SURFACES = {
    "rolling": (Wave(0.020, 1.3, 0.5), Wave(0.012, -0.4, 1.5, 0.3)),
    "rippled": (Wave(0.005, 0.3, 3.5), Wave(0.006, 1.1, 0.4, 0.2)),
    "hammered": (Wave(0.0035, 2.5, 2.5), Wave(0.0035, 2.5, -2.5, 0.25)),
    "fluted": (Wave(0.0055, 3.5, 0.3),),
}


def wavy_mirror(rng: np.random.Generator) -> Description:
    """A mirrored pillar, its four sides rolling, rippled, hammered and fluted: bumps of the surface, not of a map."""
    parts = [*walls(rng), *blocks(BLOCKS, rng), *_posts_and_slabs(rng)]
    for side, waves in zip(box((0, 0, FOOT), (SIDE, SIDE, TOP - FOOT), 20), SURFACES.values(), strict=False):
        mirror = Waves(side.corner, side.across, side.down, waves)
        parts.append(Part(mirror, to_linear(tex.plain(tex.grid(1, 1)[0], tex.SLATE)), reflectance=0.9))
    return Description(parts, panorama(rng), Orbit((0, 0, 0.9), 2.2, 0.12, 1.35, 0.35, 68), far_points=12)


def _posts_and_slabs(rng: np.random.Generator) -> list[Part]:
    """What frames the mirrors: a plinth, a top, and a post at each corner."""
    parts = []
    for base, height, period in ((0.0, FOOT, 0.3), (TOP, 0.12, 0.24)):
        for face in box((0, 0, base), (SIDE + 0.16, SIDE + 0.16, height), 20):
            x, y = tex.grid(*face.extent)
            parts.append(painted(face, tex.weathered(tex.stripes(x, y, 45, period, (tex.PLUM, tex.MUSTARD)), rng)))
    angle, half = np.radians(20), SIDE / 2
    for across, along in ((-half, -half), (half, -half), (half, half), (-half, half)):
        place = (across * np.cos(angle) - along * np.sin(angle), across * np.sin(angle) + along * np.cos(angle), FOOT)
        for face in box(place, (0.07, 0.07, TOP - FOOT), 20):
            x, y = tex.grid(*face.extent)
            parts.append(painted(face, tex.weathered(tex.checker(x, y, 0.07, (tex.CREAM, tex.INK)), rng)))
    return parts
