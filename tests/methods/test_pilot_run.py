"""What all pilot runs train on: the views made small."""

from __future__ import annotations

import pytest
import torch

from envgs_bench.core import View
from envgs_bench.methods.training.pilot_run import PIXELS, smaller
from envgs_bench.testing import tiny_scene


@pytest.mark.parametrize(
    ("size", "expected"), [((96, 72), (96, 72)), ((320, 240), (96, 72)), ((200, 3_000), (21, 324))]
)
def test_views_are_made_small_by_area(size: tuple[int, int], expected: tuple[int, int]) -> None:
    width, height = size
    camera = tiny_scene().train[0].camera.resized(width, height)
    image = torch.arange(width).expand(height, width)[..., None].expand(-1, -1, 3) * 255 / width
    normal = torch.tensor([0.0, 0.6, 0.8]).expand(height, width, 3)
    mask = torch.ones(height, width, dtype=torch.bool)
    small = smaller(View("view", camera, image.byte(), {"transmissive": mask}, normal))
    assert not small.masks  # of any size: what masks say of glass, a pilot run finds out
    assert (small.camera.width, small.camera.height) == expected
    assert small.image.shape == (expected[1], expected[0], 3)
    assert expected[0] * expected[1] <= PIXELS
    ramp = (torch.arange(expected[0]) + 0.5) * 255 / expected[0]
    assert (small.image[0, :, 0] - ramp).abs().max() < 3
    assert small.normal is not None
    torch.testing.assert_close(small.normal[0], normal[0, : expected[0]])
