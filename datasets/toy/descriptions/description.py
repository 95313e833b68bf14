"""Description: a toy scene before any light falls on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...formats.srgb import to_linear
from ..shapes import Shape
from ..world import Part

Array = NDArray[np.floating[Any]]
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Orbit:
    """A closed path of cameras around `target`, varying in height and in distance."""

    target: Vector
    radius: float
    radius_swing: float
    height: float
    height_swing: float
    field_of_view_degrees: float  # horizontal


@dataclass(frozen=True)
class Description:
    """All there is to know of a toy scene. World units are meters, z is up."""

    parts: list[Part]
    sky: Array  # [H, W, 3] linear radiance
    orbit: Orbit
    far_points: int  # points on the sky, in the point cloud
    bounces: int = 5  # reflections and refractions followed along one path


def painted(shape: Shape, picture: Array) -> Part:
    """The diffuse surface with an sRGB picture [H, W, 3]."""
    return Part(shape, to_linear(picture))


def metallic(shape: Shape, metal: str, roughness: float = 0.0) -> Part:
    """The bare metal of this chemical symbol."""
    return Part(shape, np.ones((1, 1, 3)), metal=metal, roughness=roughness)
