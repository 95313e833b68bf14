"""The toy scenes as code: which surfaces stand where, what they are painted with, and where the cameras go round."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .descriptions.brushed_patio import brushed_patio
from .descriptions.chrome_room import chrome_room, diffuse_room
from .descriptions.copper_table import copper_table
from .descriptions.description import Description, Orbit
from .descriptions.facing_mirrors import facing_mirrors
from .descriptions.glass import glass
from .descriptions.lacquered_table import lacquered_table
from .descriptions.sky_ball import sky_ball
from .descriptions.thin_rails import thin_rails
from .descriptions.wavy_mirror import wavy_mirror

__all__ = ["SCENES", "Description", "Orbit"]

SCENES: dict[str, Callable[[np.random.Generator], Description]] = {
    "chrome_room": chrome_room,
    "sky_ball": sky_ball,
    "diffuse_room": diffuse_room,
    "lacquered_table": lacquered_table,
    "facing_mirrors": facing_mirrors,
    "glass": glass,
    "wavy_mirror": wavy_mirror,
    "thin_rails": thin_rails,
    "copper_table": copper_table,
    "brushed_patio": brushed_patio,
}
