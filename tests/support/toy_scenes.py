"""What tests of the toy scenes share: coarse settings, plain materials, a camera."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

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
def coarse_toys() -> Iterator[None]:
    """Within it toy scenes have grainier light and coarser textures and sky: they are made ten times sooner."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lighting, "GATHERED_RAYS", 9)
        patch.setattr(lighting, "TEXEL", 0.25)
        patch.setattr(textures, "TEXELS_PER_METER", 20)
        patch.setattr(sky, "ROWS", 64)
        patch.setattr(sky, "COLUMNS", 128)
        yield


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
