"""What tests of the toy scenes share: coarse settings, plain materials, a camera."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

import numpy as np
import pytest
import torch

from envgs_bench.core import Camera, Scene
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS
from envgs_bench.datasets.toy import lighting, sky, textures
from envgs_bench.datasets.toy.cameras import look_at

BLACK = np.zeros((4, 8, 3))  # a sky
GRAY = np.full((2, 2, 3), 0.5)  # an albedo


@contextmanager
def coarse_toys(
    texels: int = 64, rays: int = 16, sky_rows: int = 256, places: float = lighting.TEXEL
) -> Iterator[None]:
    """Within it toy scenes have grainier light and coarser textures and sky: they are made sooner.

    By default photographs are still such that what is wrong with them shows. Of textures there are so many texels a
    meter; light is gathered by so many rays, at places so far apart, world units.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lighting, "GATHERED_RAYS", rays)
        patch.setattr(lighting, "TEXEL", places)
        patch.setattr(textures, "TEXELS_PER_METER", texels)
        patch.setattr(sky, "ROWS", sky_rows)
        patch.setattr(sky, "COLUMNS", 2 * sky_rows)
        yield


def rough_toys() -> AbstractContextManager[None]:
    """As coarse as a scene can be of which only the shapes, regions and files count: made ten times sooner."""
    return coarse_toys(texels=20, rays=9, sky_rows=64, places=0.25)


def worst(scene: Scene, kind: str) -> Scene:
    """The scene with the worst severity of what is wrong with its data."""
    perturbation = PERTURBATIONS[kind]
    return perturbation.applied(scene, len(perturbation.levels), kind, seed=0)


def camera_at(
    center: tuple[float, float, float], target: tuple[float, float, float] = (0, 0, 0), size: int = 40
) -> Camera:
    """A square camera with its principal point off the middle."""
    pose = torch.from_numpy(look_at(np.array(center, dtype=float), np.array(target, dtype=float))).float()
    intrinsics = torch.tensor([[1.1 * size, 0, 0.47 * size], [0, 1.2 * size, 0.55 * size], [0, 0, 1]])
    return Camera(pose, intrinsics, size, size)
