"""Colors at 0: where the sum before the clamp is 0 they learn, where it is negative they do not, in every backend.

So does the code of 3D and 2D Gaussian Splatting and of EnvGS's tracer. A black point of COLMAP is exactly there.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from core_scenes import Backend, dressed, plain_camera
from torch import Tensor

from envgs_bench.core import GaussianSet, Rendering
from envgs_bench.methods.gaussians.parameters import sh_from_rgb

KINDS = ("surfels", "gaussians_3d")
COLORS = ("degree 0", "degree 2", "sites")
BLACK_BUT_BLUE = torch.tensor([[0.0, 0.0, 0.2]])
NEGATIVE = torch.tensor([[-1e-6, 0.0, 0.2]])


def point(rgb: Tensor, kind: str, colors: str) -> GaussianSet:
    """One primitive of this color ahead of `plain_camera`, as an initialized training has it."""
    columns = 2 if kind == "surfels" else 3
    if colors == "sites":  # alike, so that every direction shows `rgb`
        sh = torch.cat([rgb[:, None].expand(1, 8, 3), 0.5 * torch.ones(1, 8, 3)], dim=-1)
    else:
        sh = torch.cat(sh_from_rgb(rgb, int(colors[-1])), dim=1)
    return GaussianSet(
        means=torch.tensor([[0.1, -0.05, 3.0]]),
        quaternions=torch.tensor([[1.0, 0.1, -0.2, 0.3]]),
        scales=torch.full((1, columns), 0.3),
        opacities=torch.tensor([0.6]),
        sh=sh,
    )


def gradients_of_color(leaves: GaussianSet, drawn: Rendering) -> Tensor:
    """dL/dsh [K, 3] of L = Σ color, on the CPU."""
    drawn.color.sum().backward()
    assert leaves.sh.grad is not None
    return leaves.sh.grad[0, :, :3].double().cpu()


def check(backend: Backend, gradients: Tensor) -> None:
    """Of a color (0, 0, 0.2): all channels weigh alike in Σ color, so that their gradients are the same numbers."""
    assert gradients[:, 2].abs().max() > 0.1
    for channel in (0, 1):
        torch.testing.assert_close(gradients[:, channel], gradients[:, 2], atol=0, rtol=backend.tolerance)


@pytest.mark.parametrize("colors", COLORS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_black_point_learns_from_an_image(rasterizer: Backend, kind: str, colors: str) -> None:
    leaves = rasterizer.take(point(BLACK_BUT_BLUE, kind, colors))
    check(rasterizer, gradients_of_color(leaves, rasterizer.rasterize(leaves, rasterizer.take(plain_camera()))))


@pytest.mark.parametrize("sh_direction", ["center", "ray"])
@pytest.mark.parametrize("colors", COLORS)
def test_a_black_point_learns_along_rays(tracer: Backend, colors: str, sh_direction: str) -> None:
    leaves = tracer.take(point(BLACK_BUT_BLUE, "surfels", colors))
    origins, directions = (tracer.take(x.reshape(-1, 3)) for x in plain_camera().rays())
    check(tracer, gradients_of_color(leaves, tracer.trace(leaves, origins, directions, sh_direction=sh_direction)))


@pytest.mark.parametrize("colors", COLORS)
@pytest.mark.parametrize("kind", [*KINDS, "rays"])
def test_a_negative_sum_is_black_and_learns_nothing(rasterizer: Backend, kind: str, colors: str) -> None:
    leaves = rasterizer.take(point(NEGATIVE, kind.replace("rays", "surfels"), colors))
    if kind == "rays":
        drawn = rasterizer.trace(leaves, *(rasterizer.take(x) for x in plain_camera().rays()))
    else:
        drawn = rasterizer.rasterize(leaves, rasterizer.take(plain_camera()))
    assert not drawn.color[..., 0].any()
    gradients = gradients_of_color(leaves, drawn)
    assert not gradients[:, 0].any()
    assert gradients[:, 1:].abs().max() > 0.1


@pytest.mark.parametrize("kind", [*KINDS, "rays"])
def test_a_color_that_is_no_number_learns_nothing(rasterizer: Backend, kind: str) -> None:
    """As in the oracle: dL/dsh is 0 and not NaN, of either sign, where L does not see the color."""
    for nan in (torch.nan, -torch.nan):
        surfels = dressed(point(BLACK_BUT_BLUE, kind.replace("rays", "surfels"), "degree 0"))
        surfels = replace(surfels, sh=surfels.sh.index_fill(2, torch.tensor([0]), nan))
        leaves = rasterizer.take(surfels)
        if kind == "rays":
            drawn = rasterizer.trace(leaves, *(rasterizer.take(x) for x in plain_camera().rays()))
        else:
            drawn = rasterizer.rasterize(leaves, rasterizer.take(plain_camera()))
        drawn.color[..., 2].sum().backward()
        assert leaves.sh.grad is not None
        assert not leaves.sh.grad[..., 0].any()
