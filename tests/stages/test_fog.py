"""Fog over a white background, at the size of a toy: what L_norm does where no picture holds it back.

Half of the points lie on a ball; the others are white and lie around it, where a white background hides them.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn import functional
from tuned_baselines import TUNED

from envgs_bench.core import Camera, Scene, View
from envgs_bench.datasets.toy.cameras import look_at
from envgs_bench.methods.registry import create_method
from envgs_bench.stages.training import Training

SIZE, VIEWS, POINTS, STEPS = 32, 16, 300, 100
RADIUS, BOX = 0.6, 1.3  # the ball's, and half the edge of the box


def camera_around(index: int) -> Camera:
    """One of VIEWS cameras on a sphere, all around the ball."""
    height = 0.9 * (2 * (index + 0.5) / VIEWS - 1)
    angle, ring = 2 * math.pi * 0.618 * index, math.sqrt(1 - height**2)
    pose = look_at(3 * np.array([ring * math.cos(angle), ring * math.sin(angle), height]), np.zeros(3))
    intrinsics = torch.tensor([[1.8 * SIZE, 0, SIZE / 2], [0, 1.8 * SIZE, SIZE / 2], [0, 0, 1]])
    return Camera(torch.from_numpy(pose).float(), intrinsics, SIZE, SIZE)


def pattern(points: Tensor) -> Tensor:
    return 0.5 + 0.4 * torch.sin(8 * points)


def photograph(index: int) -> tuple[View, Tensor]:
    """The ball before white, and the mask [H, W] of the background."""
    camera = camera_around(index)
    origins, rays = camera.rays()
    rays = functional.normalize(rays, dim=-1)
    along = (origins * rays).sum(-1)
    inside = along.square() - origins.square().sum(-1) + RADIUS**2
    points = origins - (along + inside.clamp_min(0).sqrt())[..., None] * rays
    color = torch.where((inside > 0)[..., None], pattern(points), torch.ones(3))
    return View(f"{index:03d}", camera, (255 * color).round().to(torch.uint8)), inside <= 0


def ball_before_white() -> tuple[Scene, list[Tensor]]:
    """The scene, and the masks of its test views' background."""
    generator = torch.Generator().manual_seed(0)
    ball = RADIUS * functional.normalize(torch.randn(POINTS, 3, generator=generator), dim=-1)
    loose = BOX * (2 * torch.rand(POINTS, 3, generator=generator) - 1)
    colors = torch.cat([pattern(ball), torch.ones(POINTS, 3)])
    views = [photograph(index) for index in range(VIEWS)]
    train, test = [views[i][0] for i in range(VIEWS) if i % 4], views[::4]
    scene = Scene("ball", train, [view for view, _ in test], torch.cat([ball, loose]), colors, torch.ones(3))
    return scene, [empty for _, empty in test]


def trained(kind: str, settings: dict[str, Any], folder: Path) -> tuple[float, float]:
    """The mean alpha of what is empty, and the PSNR, over test views."""
    scene, backgrounds = ball_before_white()
    method = create_method(kind, settings)
    Training(method, scene, STEPS, seed=0).run(folder / "curve.csv", lambda event: None)
    drawn = [method.render(view.camera) for view in scene.test]
    errors = [
        (image.color.clamp(0, 1) - view.rgb()).square().mean() for image, view in zip(drawn, scene.test, strict=True)
    ]
    alpha = np.mean([float(image.alpha[empty].mean()) for image, empty in zip(drawn, backgrounds, strict=True)])
    return float(alpha), float(np.mean([-10 * math.log10(float(error)) for error in errors]))


@pytest.mark.slow
def test_blended_normals_cover_what_is_empty_and_unit_normals_do_not(tmp_path: Path) -> None:
    early = TUNED | {"normal_from": 0}
    fog, with_fog = trained("2dgs", early | {"rules": {"normal_rendered": "blended"}}, tmp_path)
    clear, without = trained("2dgs", early | {"rules": {"normal_rendered": "unit"}}, tmp_path)
    _, untouched = trained("2dgs", early | {"normal_weight": 0.0}, tmp_path)
    assert fog > clear + 0.15  # 0.59 and 0.41; after 200 steps 0.70 and 0.31
    assert with_fog < without - 3.0  # 16.3 dB and 20.4
    assert without > untouched - 0.5  # 20.3
