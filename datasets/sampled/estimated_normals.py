"""Normals of training views as an estimator gives them: smooth, off by whole surfaces, and fooled by mirrors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from envgs_bench.core import Camera

from ..toy.normal_noise import smooth_rotations, turned_normals
from ..toy.world import Array
from .distribution import MIRRORS_TAKEN_FOR_ROOMS, NORMALS_BLUR, NORMALS_OFF, between
from .truth import Truth

COARSE = 4  # pixels along a cell of what varies smoothly: its finest waves are a fortieth of a picture


@dataclass(frozen=True)
class Estimator:
    """One of a scene's own quality."""

    degrees: float  # mean angle of what varies smoothly
    blur: float  # of the picture's width
    fooled: float  # how far the normals of mirrors are those of what they show, in [0, 1]

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Estimator:
        limits = (NORMALS_OFF, NORMALS_BLUR, MIRRORS_TAKEN_FOR_ROOMS)
        return cls(*(between(rng, limit) for limit in limits))

    def estimate(self, truth: Truth, camera: Camera, rng: np.random.Generator) -> Array:
        """[H, W, 3] unit, facing the camera; 0 where nothing is met."""
        sharp = truth.regions["mirror"] | truth.regions["transmissive"]
        shown = sharp & np.any(truth.mirrored_normal, axis=-1)
        mixed = truth.normal + self.fooled * (truth.mirrored_normal - truth.normal) * shown[..., None]
        soft = np.stack([ndimage.gaussian_filter(mixed[..., c], self.blur * camera.width) for c in range(3)], -1)
        length = np.linalg.norm(soft, axis=-1, keepdims=True)
        smooth = np.where(length > 1e-3, soft / np.maximum(length, 1e-3), truth.normal)
        smooth[truth.depth == 0] = 0
        directions = camera.rays()[1].double().numpy()
        height, width = truth.depth.shape
        coarse = smooth_rotations((-(-height // COARSE), -(-width // COARSE)), self.degrees, rng)
        rotation = ndimage.zoom(coarse, (COARSE, COARSE, 1), order=1, mode="nearest", grid_mode=True)[:height, :width]
        return turned_normals(smooth.astype(np.float64), directions, rotation)
