"""PathTraced: a toy scene's pictures by Mitsuba, with all the light that our own renderer leaves out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from envgs_bench.core import Camera

from ..formats.srgb import to_srgb
from ..path_tracer import Bsdf, PathTracer, Texture, TracedSurface, Tracer
from .shapes import tessellate
from .world import Array, Part


class PathTraced:
    """Parts under a sky, as Mitsuba's scene: textured, metals and coats by Fresnel's equations, every bounce of light.

    What `World` bakes and approximates is simulated: shadows of the sun, color that one surface throws on another,
    light that mirrors gather (caustics), reflection that grows toward grazing.

    Args:
        parts: surfaces, of which none is of glass.
        sky: [H, W, 3] linear radiance from infinity.
        tracer: where Mitsuba works; that of a GPU is for one thread.

    Raises:
        DatasetError: Mitsuba is not installed, or has no such GPU.
    """

    def __init__(self, parts: list[Part], sky: Array, tracer: Tracer = "cpu") -> None:
        self._tracer = PathTracer([_traced(part) for part in parts], sky, tracer)

    def picture(self, camera: Camera, supersampling: int, rng: np.random.Generator) -> NDArray[np.uint8]:
        """The view [H, W, 3], sRGB: a pixel is its area's mean of linear light, over supersampling² paths."""
        light = self._tracer.light(camera, supersampling, int(rng.integers(2**31)))
        return np.round(255 * to_srgb(light)).astype(np.uint8)


def _traced(part: Part) -> TracedSurface:
    emission = Texture(part.emission * part.albedo) if part.emission else None
    return TracedSurface(tessellate(part.shape), _bsdf(part), emission)


def _bsdf(part: Part) -> Bsdf:
    """The part's surface, the same from both sides. A roughness is the square root of GGX's alpha."""
    facets = {"distribution": "ggx", "alpha": part.roughness**2} if part.roughness else {}
    rough = "rough" if facets else ""
    if part.metal:
        surface = {"type": f"{rough}conductor", "material": part.metal, **facets}
    elif part.coat:
        color = Texture(part.albedo)
        surface = {"type": f"{rough}plastic", "int_ior": part.coat, "diffuse_reflectance": color, **facets}
    else:
        surface = {"type": "diffuse", "reflectance": Texture(part.albedo)}
    return {"type": "twosided", "surface": surface}
