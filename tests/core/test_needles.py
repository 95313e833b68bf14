"""3D Gaussians many times longer than wide: a picture and each gradient in float32 against float64."""

from __future__ import annotations

import math

import pytest
import torch
from backends import EMULATED, usable
from core_scenes import (
    FIELDS,
    ORACLE,
    Backend,
    colored,
    dressed,
    gradients_of,
    plain_camera,
    rasterized,
    relative_error,
    steady,
)
from oracle import SINGLE
from torch import Tensor

from envgs_bench.core import GaussianSet, Rendering

FOCAL = 800.0  # px
DEPTH = 4.0
LENGTHS = (80.0, 320.0, 1600.0)  # px, standard deviations on the screen
CAMERA = plain_camera(160, 120, FOCAL)


@pytest.fixture(params=["cpu", "cuda", "torch", EMULATED])
def single(request: pytest.FixtureRequest) -> Backend:
    return SINGLE if request.param == "torch" else usable(request)


def needles(angle: float, width: float, slant: float) -> GaussianSet:
    """One of each length, side by side.

    Args:
        angle: on the screen, from the x axis, degrees.
        width: px, a standard deviation.
        slant: out of the screen's plane, degrees.
    """
    turn, lean = math.radians(angle) / 2, math.radians(slant) / 2
    quaternion = torch.tensor(
        [
            math.cos(turn) * math.cos(lean),
            -math.sin(turn) * math.sin(lean),
            math.cos(turn) * math.sin(lean),
            math.sin(turn) * math.cos(lean),
        ]
    )
    count = len(LENGTHS)
    long = torch.tensor(LENGTHS)[:, None] * DEPTH / FOCAL
    thin = torch.tensor([[1.2, 1.0]]) * width * DEPTH / FOCAL
    places = torch.linspace(-0.15, 0.15, count)
    return dressed(
        GaussianSet(
            means=torch.stack([places, -places, DEPTH + 0.1 * places], dim=1),
            quaternions=quaternion.expand(count, 4),
            scales=torch.cat([long, thin.expand(count, 2)], dim=1),
            opacities=torch.tensor([0.7, 0.5, 0.6]),
            sh=colored(torch.tensor([[0.9, 0.2, 0.3], [0.3, 0.8, 0.2], [0.2, 0.4, 0.9]])),
        )
    )


def loss_of(drawn: Rendering, keep: Tensor) -> Tensor:
    """Smooth over the kept pixels, so that a needle's length counts in it."""
    rows, columns = torch.meshgrid(torch.arange(CAMERA.height), torch.arange(CAMERA.width), indexing="ij")
    upstream = keep * (1 + (rows / CAMERA.height - 0.5) ** 2 + columns / CAMERA.width)
    fields = torch.cat([getattr(drawn, name).reshape(*keep.shape, -1) for name in FIELDS], dim=-1)
    return (upstream.to(fields)[..., None] * fields).sum()


@pytest.mark.parametrize("low_pass", [True, False], ids=["low-pass", "exact"])
@pytest.mark.parametrize(("angle", "slant"), [(45.3, 0), (45.3, 25), (-44.1, 10), (0.4, 25), (89.7, -25)])
def test_needles(single, angle, slant, low_pass):
    """Each needle's gradients beside its own size, and that of its length, which is the smallest, beside itself."""
    gaussians = needles(angle, 0.25 if low_pass else 0.8, slant)
    keep = steady(gaussians, rasterized(gaussians, CAMERA, low_pass=low_pass))
    assert keep.double().mean() > 0.95

    def drawn_by(backend: Backend) -> tuple[Rendering, dict[str, Tensor]]:
        leaves = backend.take(gaussians)
        drawn = backend.rasterize(leaves, backend.take(CAMERA), low_pass=low_pass)
        loss_of(drawn, keep).backward()
        return drawn, gradients_of(leaves)

    (drawn, gradients), (expected, expected_gradients) = drawn_by(single), drawn_by(ORACLE)
    assert torch.equal(drawn.hits.cpu()[keep], expected.hits[keep])
    for name in FIELDS:
        assert relative_error(getattr(drawn, name).cpu()[keep], getattr(expected, name)[keep]) < 1e-4, name
    for k, length in enumerate(LENGTHS):
        for name, gradient in gradients.items():
            assert relative_error(gradient[k], expected_gradients[name][k]) < 1e-3, (name, length)
    lengths, expected_lengths = gradients["scales"][:, 0], expected_gradients["scales"][:, 0]
    torch.testing.assert_close(lengths, expected_lengths, rtol=0.01, atol=0)
