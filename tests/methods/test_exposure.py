"""Each training view's own exposure: the identity at the start, learned where views differ, no part of the model."""

from __future__ import annotations

import copy
from dataclasses import replace

import pytest
import torch

from envgs_bench.core import Scene
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.training.exposure import WEIGHT, AffineExposure
from envgs_bench.testing import tiny_scene

CPU = torch.device("cpu")
SMALL = {"env_grid": 2, "env_far_count": 10}


def method_of(kind: str, exposure: str) -> GaussianMethod:
    method = create_method(kind, (SMALL if kind == "envgs" else {}) | {"exposure": exposure}, seed=0)
    assert isinstance(method, GaussianMethod)
    return method


def darkened(scene: Scene, view: int) -> Scene:
    train = list(scene.train)
    train[view] = replace(train[view], image=(train[view].image // 2))
    return replace(scene, train=train)


def test_a_map_is_affine_and_held_to_the_identity() -> None:
    exposure, color = AffineExposure(["a", "b"], CPU), torch.rand(4, 5, 3)
    assert torch.equal(exposure.applied("a", color), color)
    assert exposure.loss("a") == 0
    with torch.no_grad():
        exposure.maps[1] = torch.tensor([[0.5, 0, 0, 0.1], [0, 2, 0, 0], [0, 0.25, 1, 0]])
    red, green, blue = color.unbind(-1)
    expected = torch.stack([0.5 * red + 0.1, 2 * green, 0.25 * green + blue], dim=-1)
    torch.testing.assert_close(exposure.applied("b", color), expected)
    assert exposure.loss("b").item() == pytest.approx(WEIGHT * (0.25 + 0.01 + 1 + 0.0625) / 12)
    assert torch.equal(exposure.applied("a", color), color)


def test_the_map_of_a_darker_view_is_found() -> None:
    color = torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(0))
    exposure = AffineExposure(["dark", "as it is"], CPU)
    for _ in range(600):
        for name, gain in (("dark", 0.7), ("as it is", 1.0)):
            ((exposure.applied(name, color) - gain * color).square().mean() + exposure.loss(name)).backward()
        exposure.optimizer.step()
        exposure.optimizer.zero_grad()
    shown = exposure.applied("dark", color)
    assert float((shown / color).detach().median()) == pytest.approx(0.7, abs=0.03)
    torch.testing.assert_close(exposure.applied("as it is", color), color, atol=0.01, rtol=0)


@pytest.mark.parametrize("kind", ["2dgs", "3dgs", "envgs", "envmap"])
def test_the_first_step_is_that_without_and_pictures_show_the_scene_itself(kind: str) -> None:
    scene, terms = tiny_scene(), {}
    for exposure in ("none", "affine"):
        method = method_of(kind, exposure)
        method.initialize(scene, 10)
        terms[exposure] = method.training_step(scene.train[0], 1)
    assert float(terms["affine"].pop("exposure")) == 0
    assert {name: float(value) for name, value in terms["affine"].items()} == pytest.approx(
        {name: float(value) for name, value in terms["none"].items()}, rel=1e-6
    )
    method.prepare()
    before = method.render(scene.test[0].camera).color
    assert method.runner.exposure is not None
    with torch.no_grad():
        method.runner.exposure.maps.zero_()
    assert torch.equal(method.render(scene.test[0].camera).color, before)


def test_a_view_that_is_darker_becomes_so_by_its_map() -> None:
    scene, method = darkened(tiny_scene(), 2), method_of("2dgs", "affine")
    method.initialize(scene, 60)
    for step in range(1, 61):
        method.training_step(scene.train[step % len(scene.train)], step)
    assert method.runner.exposure is not None
    gains = method.runner.exposure.maps.detach()[:, :, :3].diagonal(dim1=1, dim2=2).mean(dim=1)
    assert gains.argmin() == 2


def test_an_interrupted_training_goes_on_with_its_maps() -> None:
    scene = darkened(tiny_scene(), 1)
    first, second = method_of("2dgs", "affine"), method_of("2dgs", "affine")
    first.initialize(scene, 10)
    for step in range(1, 5):
        first.training_step(scene.train[step % 3], step)
    second.resume(scene, 10, copy.deepcopy(first.training_state()))
    losses = [
        [float(m.training_step(scene.train[step % 3], step)["loss"]) for step in (5, 6, 7)] for m in (first, second)
    ]
    assert losses[0] == losses[1]
