"""Which primitives are in view, against the projections of points on their outlines."""

from __future__ import annotations

import math

import pytest
import torch

from envgs_bench.core import Camera
from envgs_bench.methods.gaussians.frustum import REACH, in_view

CAMERA = Camera(torch.eye(4), torch.tensor([[50.0, 0, 20], [0, 40.0, 15], [0, 0, 1]]), 40, 30)


def test_a_disc_across_the_view_is_in_view_where_its_outline_reaches_the_picture():
    """Discs parallel to the picture beyond its left edge, just near enough and just not."""
    scale, depth = 0.2, 4.0
    edge = -20 / 50 * depth  # where the left edge of the picture lies at that depth
    reach = (REACH**2 * (scale**2 + 0.5 * (depth / 50) ** 2)) ** 0.5  # with the low-pass's half a square pixel
    means = torch.tensor([[edge - 0.99 * reach, 0, depth], [edge - 1.01 * reach, 0, depth]])
    assert in_view(means, torch.full((2, 2), scale), CAMERA, 0.2).tolist() == [True, False]


@pytest.mark.parametrize(
    ("mean", "expected"),
    [
        ((0, 0, 0.3), True),
        ((0, 0, 0.1), False),  # nearer than near
        ((0, 0, -3), False),
        ((0, 100, 3), False),
        ((0, -100, 3), False),
        ((100, 0, 3), False),
        ((1.1, 0, 3), True),
    ],
)
def test_what_is_ahead_and_not_beside_is_in_view(mean, expected):
    found = in_view(torch.tensor([mean], dtype=torch.float32), torch.full((1, 3), 1e-3), CAMERA, 0.2)
    assert found.tolist() == [expected]


def test_no_primitive_with_a_point_in_the_picture_is_missed():
    """Centers all around, beside and behind: whatever has a point within three deviations on the picture is in view."""
    generator = torch.Generator().manual_seed(0)
    means = 6 * torch.rand(3000, 3, generator=generator) - torch.tensor([3.0, 3.0, 1.0])
    scales = 0.3 * torch.rand(3000, 2, generator=generator)
    angles = torch.linspace(0, 2 * math.pi, 33)[:-1]
    outline = torch.stack([angles.cos(), angles.sin(), torch.zeros(32)], dim=1)
    points = means[:, None] + REACH * torch.cat([scales, torch.zeros(3000, 1)], dim=1)[:, None] * outline
    pixels, depths = CAMERA.project(points)
    inside = (pixels >= 0).all(-1) & (pixels[..., 0] <= 40) & (pixels[..., 1] <= 30) & (depths > 0.2)
    shown = inside.any(dim=1) & (means[:, 2] > 0.2)
    found = in_view(means, scales, CAMERA, 0.2)
    assert 500 < int(shown.sum()) < 2500
    assert bool(found[shown].all())
    assert int(found.sum()) < 1.5 * int(shown.sum())
