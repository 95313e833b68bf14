"""Materials: what sampled surfaces are made of, as the path tracer and as the truth know it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..path_tracer import Bsdf, Texture, TracedSurface
from ..toy.shapes import Mesh, Shape, tessellate
from .distribution import COAT, METALS, ROUGHNESS, between, one_of

Array = NDArray[np.floating[Any]]

COATED = ("lacquer", "varnish", "car_paint", "water")
METALLIC = ("smooth_metal", "brushed_metal", "mirror")
CLEAR = ("glass", "pane", "stained")
BLANK = np.full((1, 1, 3), 0.5)


@dataclass(frozen=True)
class Material:
    """How a surface reflects. Its color is its texture's, or its metal's."""

    name: str = "diffuse"
    roughness: float = 0.0  # the square root of GGX's alpha
    metal: str = ""  # a chemical symbol
    ior: float = 1.5  # index of refraction, of a coat or of what is clear

    @property
    def reflective(self) -> bool:
        """Whether things show in it: diffuse and satin surfaces are too rough."""
        return self.name not in ("diffuse", "satin")

    @property
    def mirror(self) -> bool:
        return self.name in METALLIC and self.roughness == 0

    def bsdf(self, linear: Array) -> Bsdf:
        """For a surface of this color [H, W, 3], the same from both sides but for a solid of glass."""
        facets: Bsdf = {"distribution": "ggx", "alpha": max(self.roughness, 0.05) ** 2} if self.roughness else {}
        rough, color = "rough" if facets else "", Texture(np.clip(linear, 1e-3, 0.95))
        if self.name == "glass":
            return {"type": "dielectric", "int_ior": self.ior}
        if self.name == "pane":
            return {"type": "thindielectric", "int_ior": self.ior}
        if self.name == "stained":
            return {"type": "thindielectric", "int_ior": self.ior, "specular_transmittance": color}
        if self.name in METALLIC:
            surface: Bsdf = {"type": f"{rough}conductor", "material": self.metal, **facets}
        elif self.name == "car_paint":
            paint = {"metallic": 0.6, "roughness": 0.45, "clearcoat": 1.0, "clearcoat_gloss": 0.98}
            surface = {"type": "principled", "base_color": color, **paint}
        elif self.name == "diffuse":
            surface = {"type": "diffuse", "reflectance": color}
        else:
            surface = {"type": f"{rough}plastic", "int_ior": self.ior, "diffuse_reflectance": color, **facets}
        return {"type": "twosided", "surface": surface}


DIFFUSE = Material()
MIRROR = Material("mirror", metal="Ag")
PANE = Material("pane")
STAINED = Material("stained")
WATER = Material("water", ior=1.33)


@dataclass(frozen=True)
class Surface:
    """One surface of a place: its shape, what it is made of and painted with, and which thing it belongs to."""

    shape: Shape | Mesh
    material: Material = DIFFUSE
    linear: Array = field(default_factory=lambda: BLANK)  # [H, W, 3] color, linear, upright as the shape's (u, v)
    thing: int = 0  # surfaces of one number are one thing: what mirrors it in itself reflects itself
    emission: float = 0.0  # radiance that it sends out, in units of its color

    def traced(self) -> TracedSurface:
        light = Texture(self.emission * self.linear) if self.emission else None
        return TracedSurface(tessellate(self.shape), self.material.bsdf(self.linear), light)


def drawn_material(rng: np.random.Generator, name: str) -> Material:
    """One of the class `name`: a key of `distribution.MATERIALS`, or diffuse."""
    roughness = between(rng, ROUGHNESS[name]) if name in ROUGHNESS else 0.0
    metal = one_of(rng, METALS) if name in METALLIC else ""
    return Material(name, roughness, metal, between(rng, COAT))
