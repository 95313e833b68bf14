"""Normals, mirrored directions and single colors of primitives, against what the core draws of them."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch.nn import functional

from envgs_bench.core import GaussianSet, rasterize
from envgs_bench.methods.lighting.shading import colored, mirrored, seen_from
from envgs_bench.testing import tiny_scene

CAMERA = tiny_scene().test[0].camera


def one_primitive(axes: int, seed: int) -> GaussianSet:
    """A flat opaque primitive of any orientation at the origin."""
    generator = torch.Generator().manual_seed(seed)
    return GaussianSet(
        means=torch.zeros(1, 3),
        quaternions=torch.randn(1, 4, generator=generator),
        scales=torch.tensor([[0.5, 0.05, 0.4]]) if axes == 3 else torch.tensor([[0.5, 0.4]]),
        opacities=torch.tensor([0.9]),
        sh=torch.zeros(1, 9, 3),
    )


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_normals_are_those_that_the_core_draws(axes: int, seed: int) -> None:
    gaussians = one_primitive(axes, seed)
    drawn = rasterize(gaussians, CAMERA)
    row, column = divmod(int(drawn.alpha.argmax()), CAMERA.width)
    directions, normals, _ = seen_from(gaussians, CAMERA.center)
    torch.testing.assert_close(normals[0], functional.normalize(drawn.normal[row, column], dim=0), atol=1e-4, rtol=0)
    torch.testing.assert_close(directions[0], functional.normalize(-CAMERA.center, dim=0))
    assert (directions * normals).sum() <= 0


def test_a_row_in_the_order_of_the_scales_may_stand_for_the_shortest_axis() -> None:
    """As GaussianShader's code takes it; of a quarter turn about z, whose first row is (0, −1, 0)."""
    turned = torch.tensor([[math.sqrt(0.5), 0, 0, math.sqrt(0.5)]])
    gaussians = replace(one_primitive(3, 0), quaternions=turned)  # scales: y, z, x
    for side in (-3.0, 3.0):  # the row, sorted: (−1, 0, 0)
        _, normals, away = seen_from(gaussians, torch.tensor([side, 1, 1]), "row")
        assert bool(away) == (side > 0)
        torch.testing.assert_close(normals, torch.tensor([[math.copysign(1, side), 0, 0]]), atol=1e-6, rtol=0)


def test_a_mirror_keeps_the_angle_and_turns_about_the_normal() -> None:
    generator = torch.Generator().manual_seed(0)
    directions, normals = functional.normalize(torch.randn(2, 20, 3, generator=generator), dim=-1)
    normals = torch.where(((directions * normals).sum(-1) > 0)[:, None], -normals, normals)
    outgoing, cosine = mirrored(directions, normals)
    torch.testing.assert_close((outgoing * normals).sum(-1), cosine)
    torch.testing.assert_close(functional.normalize(outgoing - directions, dim=-1), normals, atol=1e-5, rtol=0)
    torch.testing.assert_close(outgoing.norm(dim=-1), torch.ones(20))
    assert (cosine >= 0).all()


def test_a_colored_primitive_is_drawn_in_its_color() -> None:
    color = torch.tensor([[0.1, 0.9, 0.4]])
    drawn = rasterize(colored(one_primitive(2, 0), color), CAMERA)
    solid = drawn.alpha > 0.1
    assert solid.any()
    shown = (drawn.color / drawn.alpha[..., None])[solid]
    torch.testing.assert_close(shown, color.expand_as(shown))
