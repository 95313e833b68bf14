"""Photographs' noise is told from what a model has wrong, and SSIM counts for less beside it while sets are pruned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from envgs_bench.core import Rendering, Statistics, View
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.gaussians.beside_noise import share_beside_noise
from envgs_bench.methods.gaussians.pruning import Prunings
from envgs_bench.methods.registry import create_method
from envgs_bench.testing import tiny_scene

SIDE = 96


def noise(shape: torch.Size | tuple[int, ...], deviation: float, seed: int = 0) -> Tensor:
    return deviation * torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def wrong(deviation: float) -> Tensor:
    """What a model might have wrong, over several pixels: [SIDE, SIDE, 3]."""
    rough = noise((1, 3, SIDE + 8, SIDE + 8), 1.0)
    smooth = torch.nn.functional.avg_pool2d(torch.nn.functional.avg_pool2d(rough, 5, stride=1), 5, stride=1)
    return deviation * (smooth / smooth.std())[0].permute(1, 2, 0)


def drawn(error: Tensor) -> tuple[Rendering, View]:
    """A picture that is off by so much [SIDE, SIDE, 3] from a gray photograph."""
    image = torch.full((SIDE, SIDE, 3), 128, dtype=torch.uint8)
    view = View("gray", tiny_scene().train[0].camera.resized(SIDE, SIDE), image)
    color, flat = view.rgb() + error, torch.zeros(SIDE, SIDE)
    return Rendering(color, flat, flat, color, flat[..., None], flat.int(), Statistics(flat)), view


@pytest.mark.parametrize("deviation", [0.0, 0.02, 0.05, 0.1])
def test_the_share_of_what_a_model_has_wrong_is_found_beside_noise(deviation: float) -> None:
    share = share_beside_noise([drawn(wrong(0.05) + noise((SIDE, SIDE, 3), deviation))])
    assert share == pytest.approx(0.05**2 / (0.05**2 + deviation**2), abs=0.12)


def test_noise_that_differs_from_place_to_place_is_found_too() -> None:
    everywhere = 0.2 * torch.linspace(0, 1, SIDE)[:, None, None] ** 3  # as of paths: none where a picture is flat
    share = share_beside_noise([drawn(wrong(0.05) + noise((SIDE, SIDE, 3), 1.0) * everywhere)])
    assert share == pytest.approx(0.05**2 / (0.05**2 + float(everywhere.square().mean())), abs=0.12)


def test_views_count_by_their_squared_errors() -> None:
    noisy, smooth = drawn(noise((SIDE, SIDE, 3), 0.06)), drawn(wrong(0.03))
    assert share_beside_noise([noisy, smooth]) == pytest.approx(0.2, abs=0.04)


def test_a_share_lies_between_none_and_all() -> None:
    assert share_beside_noise([drawn(torch.zeros(SIDE, SIDE, 3))]) == 1.0
    assert share_beside_noise([drawn(torch.full((SIDE, SIDE, 3), 0.1))]) == pytest.approx(1.0)
    checks = (torch.arange(SIDE)[:, None] + torch.arange(SIDE)) % 2 - 0.5
    assert share_beside_noise([drawn(checks[..., None].expand(-1, -1, 3))]) == 0.0


OWN = {"prune_error": 0.05, "prune_from": 10_000, "densify_until": 0}


def trained_on(deviation: float, steps: int) -> tuple[GaussianMethod, Prunings]:
    """Of a run of 60 steps, whose prunings begin after step 20, on photographs with so much noise."""
    method, scene = create_method("2dgs", OWN, seed=1), tiny_scene()
    assert isinstance(method, GaussianMethod)
    noisy = [
        replace(view, image=(255 * (view.rgb() + noise(view.image.shape, deviation, k)).clamp(0, 1)).round().byte())
        for k, view in enumerate(scene.train)
    ]
    method.initialize(replace(scene, train=noisy), 60)
    for step in range(1, steps + 1):
        method.training_step(noisy[step % len(noisy)], step)
    prunings = method.parts["prunings"]
    assert isinstance(prunings, Prunings)
    return method, prunings


def test_ssim_has_its_share_of_a_run_by_how_noisy_the_views_are() -> None:
    shares = []
    for deviation in (0.0, 0.2):
        method, prunings = trained_on(deviation, 20)
        _, _, _, share = method.runner.loss.began(21)
        assert share == pytest.approx(np.interp(prunings.beside_noise, [0, 1], [0.2, 0.35]))
        assert method.phase(20) != method.phase(21)  # a GPU records the step anew
        assert method.runner.loss.began(20)[3] == 0.2
        shares.append(share)
    assert 0.2 <= shares[1] < shares[0] - 0.05


def test_an_interrupted_run_goes_on_with_the_share_that_was_found_and_says_it() -> None:
    method, prunings = trained_on(0.2, 31)
    (note,) = method.notes
    assert f"; {prunings.beside_noise:.0%} of their error was not noise as prunings began, so SSIM had 0.2" in note
    again = create_method("2dgs", OWN, seed=1)
    assert isinstance(again, GaussianMethod)
    again.resume(tiny_scene(), 60, method.training_state() or {})
    assert again.runner.loss == method.runner.loss
    assert again.notes == method.notes
