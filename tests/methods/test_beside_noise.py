"""Photographs' noise is told from what a model has wrong, and lets no pruning go further."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from envgs_bench.core import Rendering, Statistics, View
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.gaussians.beside_noise import LEAST, share_beside_noise
from envgs_bench.methods.gaussians.pruning import Prunings
from envgs_bench.methods.gaussians.pruning_bound import INSIDE, LPIPS, PruningBound
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


def share(error: Tensor) -> float:
    """Of a picture that is off by so much [SIDE, SIDE, 3] from a gray photograph."""
    image = torch.full((SIDE, SIDE, 3), 128, dtype=torch.uint8)
    view = View("gray", tiny_scene().train[0].camera.resized(SIDE, SIDE), image)
    color, flat = view.rgb() + error, torch.zeros(SIDE, SIDE)
    return share_beside_noise(
        [(Rendering(color, flat, flat, color, flat[..., None], flat.int(), Statistics(flat)), view)]
    )


@pytest.mark.parametrize("deviation", [0.0, 0.02, 0.05, 0.1])
def test_the_share_of_what_a_model_has_wrong_is_found_beside_noise(deviation: float) -> None:
    error = wrong(0.05) + noise((SIDE, SIDE, 3), deviation)
    assert share(error) == pytest.approx(0.05**2 / (0.05**2 + deviation**2), abs=0.12)


def test_noise_that_differs_from_place_to_place_is_found_too() -> None:
    everywhere = 0.2 * torch.linspace(0, 1, SIDE)[:, None, None] ** 3  # as of paths: none where a picture is flat
    error = wrong(0.05) + noise((SIDE, SIDE, 3), 1.0) * everywhere
    expected = 0.05**2 / (0.05**2 + float(everywhere.square().mean()))
    assert share(error) == pytest.approx(expected, abs=0.12)


def test_shares_stay_where_a_pruning_is_possible() -> None:
    assert share(torch.zeros(SIDE, SIDE, 3)) == 1.0
    assert share(torch.full((SIDE, SIDE, 3), 0.1)) == pytest.approx(1.0)
    checks = (torch.arange(SIDE)[:, None] + torch.arange(SIDE)) % 2 - 0.5
    assert share(checks[..., None].expand(-1, -1, 3)) == LEAST  # a texture that is not learned


def left_beside(deviation: float) -> int:
    """Primitives after one pruning of the same set, whose photographs have so much noise."""
    method = create_method("2dgs", {"prune_error": 0.05, "densify_until": 0}, seed=1)
    assert isinstance(method, GaussianMethod)
    scene = tiny_scene()
    method.initialize(scene, 60)
    for step in range(1, 30):
        method.training_step(scene.train[step % len(scene.train)], step)
    assert method.drawn is not None
    noisy = []
    for seed, view in enumerate(scene.train):
        picture = view.rgb() + noise(view.image.shape, deviation, seed)
        noisy.append(replace(view, image=(255 * picture.clamp(0, 1)).round().byte()))
    prunings = Prunings(replace(method.drawn, views=lambda: noisy, sample=lambda: noisy), [])
    with torch.no_grad():
        prunings(30)
    assert prunings.counts[1] < prunings.counts[0]
    return prunings.counts[1]


def test_a_set_is_pruned_no_further_where_its_photographs_are_noisy() -> None:
    without = left_beside(0.0)
    assert left_beside(0.1) >= 0.97 * without


def test_bounds_of_psnr_count_what_is_not_noise_alone() -> None:
    bound, seen = PruningBound(), {"PSNR": 24.0, INSIDE: 20.0, LPIPS: 0.2}
    assert bound.allows(seen, 0.25)
    assert bound.allows(seen | {"PSNR": 23.98, LPIPS: 0.202}, 0.25)
    assert not bound.allows(seen | {"PSNR": 23.97}, 0.25)
    assert bound.beyond == "PSNR 0.03, more than 0.025"
    assert not bound.allows(seen | {INSIDE: 19.97}, 0.25)
    assert bound.allows(seen | {"PSNR": 23.95, INSIDE: 19.95})
    again = PruningBound()
    again.restore_training(bound.training_state())
    assert (again.share, again.best) == (1.0, seen)
