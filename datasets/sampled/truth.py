"""Truth: what the rays through pixel centers meet, and what they see there once mirrored."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envgs_bench.core import Camera

from ..toy.world import OFFSET, Array, Part, World, reflect_directions
from .materials import BLANK, CLEAR, COATED, Surface

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Truth:
    """Of one view."""

    depth: Array  # [H, W] camera-frame z; 0 where nothing is met
    normal: Array  # [H, W, 3] world frame, unit, facing the camera; 0 where nothing is met
    regions: dict[str, Mask]  # [H, W] each
    roughness: (
        Array  # [H, W] the square root of GGX's alpha; 0 on mirrors, 1 on what is diffuse and where nothing is met
    )
    mirrored: Array  # [H, W] distance from a reflective surface to what it mirrors; 0 where that is the sky
    mirrored_normal: Array  # [H, W, 3] of what is mirrored, as the mirror shows it; 0 where that is the sky


class TruthOf:
    """Of all the views of a place."""

    def __init__(self, surfaces: list[Surface]) -> None:
        self.world = World([Part(surface.shape, BLANK) for surface in surfaces], np.zeros((2, 4, 3)))
        materials = [surface.material for surface in surfaces]
        self._thing = np.array([surface.thing for surface in surfaces])
        self._kinds = {
            "reflective": np.array([material.reflective for material in materials]),
            "mirror": np.array([material.mirror for material in materials]),
            "rough": np.array([material.reflective and material.roughness > 0 for material in materials]),
            "coated": np.array([material.name in COATED for material in materials]),
            "transmissive": np.array([material.name in CLEAR for material in materials]),
            "diffuse": np.array([not material.reflective for material in materials]),
        }
        rough = [material.roughness if material.reflective else 1.0 for material in materials]
        self._roughness = np.array(rough, np.float32)

    def __call__(self, camera: Camera) -> Truth:
        """Regions by material: `reflective`, of which `mirror` (smooth metal), `rough`, `coated`, `transmissive`; and
        `diffuse`. By what is mirrored at the pixel's center `near_field` (another thing), `self_field` (the same) and
        `far_field` (the sky).
        """
        shape = (camera.height, camera.width)
        origins, directions = (rays.reshape(-1, 3).numpy().astype(np.float32) for rays in camera.rays())
        hits = self.world.cast(np.ascontiguousarray(origins), directions)
        normals = np.zeros_like(directions)
        normals[hits.met] = self.world.normals(hits[hits.met], directions[hits.met])
        part = self.world.part(hits)
        regions = {name: hits.met & which[part] for name, which in self._kinds.items()}
        shining = np.flatnonzero(regions["reflective"])
        points = origins[shining] + hits.distance[shining, None] * directions[shining] + OFFSET * normals[shining]
        toward = reflect_directions(directions[shining], normals[shining])
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        again = self.world.cast(points.astype(np.float32), toward.astype(np.float32))
        own = again.met & (self._thing[self.world.part(again)] == self._thing[part[shining]])
        for name, which in (("near_field", again.met & ~own), ("self_field", own), ("far_field", ~again.met)):
            regions[name] = np.zeros(len(normals), np.bool_)
            regions[name][shining] = which
        mirrored, shown = np.zeros(len(normals), np.float32), np.zeros_like(normals)
        mirrored[shining] = again.distance
        met = shining[again.met]
        found = self.world.normals(again[again.met], toward[again.met])
        shown[met] = reflect_directions(found, normals[met])
        rough = np.where(hits.met, self._roughness[part], np.float32(1))
        return Truth(
            hits.distance.reshape(shape),
            normals.reshape(*shape, 3),
            {name: region.reshape(shape) for name, region in regions.items()},
            rough.reshape(shape),
            mirrored.reshape(shape),
            shown.reshape(*shape, 3),
        )
