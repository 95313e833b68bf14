"""What prunings may cost: how views' quality is told, and when it ends them."""

from __future__ import annotations

import pytest
import torch
from schedules import befall
from torch import Tensor

from envgs_bench.core import Rendering, Statistics, View
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.gaussians.pruning import Prunings
from envgs_bench.methods.gaussians.pruning_bound import BOUNDS, PruningBound, quality_of
from envgs_bench.methods.registry import create_method
from envgs_bench.metrics.psnr import psnr
from envgs_bench.metrics.ssim import ssim
from envgs_bench.parts import BETA
from envgs_bench.testing import tiny_scene

SIDE = 32


def noise_view() -> View:
    image = torch.randint(60, 200, (SIDE, SIDE, 3), generator=torch.Generator().manual_seed(0), dtype=torch.uint8)
    return View("noise", tiny_scene().train[0].camera.resized(SIDE, SIDE), image)


def drawing(color: Tensor, beta: Tensor | None = None) -> Rendering:
    flat = torch.zeros(SIDE, SIDE)
    layers = {} if beta is None else {BETA: beta[..., None]}
    return Rendering(color, flat, flat, color, flat[..., None], flat.int(), Statistics(flat), layers)


def test_quality_is_what_the_metrics_say_and_weighs_reflections_by_beta() -> None:
    view, beta = noise_view(), torch.zeros(SIDE, SIDE)
    beta[:8], beta[8:16] = 0.5, 0.25
    color = view.rgb().clone()
    color[:16] += 0.1
    color[8:] += 0.02
    found = quality_of([(drawing(color, beta), view)])
    assert found["PSNR"] == pytest.approx(psnr(color, view.rgb()), abs=1e-4)
    assert found["SSIM"] == pytest.approx(float(ssim(color, view.rgb(), "zero")), abs=1e-5)
    inside = (0.5 * 0.1**2 + 0.25 * 0.12**2) / 0.75
    assert found["PSNR inside reflections"] == pytest.approx(-10 * torch.tensor(inside).log10().item(), abs=1e-4)
    assert set(found) == set(BOUNDS)
    assert set(quality_of([(drawing(color), view)])) == {"PSNR", "SSIM"}


def test_the_bound_is_below_the_best_that_views_have_been() -> None:
    bound = PruningBound()
    psnrs = [20.0, 26.0, 25.91]  # better, then worse by 0.09, as allowed
    assert [bound.allows({"PSNR": value, "SSIM": 0.9}) for value in psnrs] == [True, True, True]
    assert not bound.allows({"PSNR": 25.89, "SSIM": 0.8979})  # less than the best by 0.11, and than the last by 0.02
    assert bound.ended == "PSNR fell by 0.11, more than 0.1 and SSIM fell by 0.0021, more than 0.002"
    assert not bound.allows({"PSNR": 40.0, "SSIM": 1.0})  # for good
    assert bound.ended.startswith("PSNR fell by 0.11")


def test_a_run_says_what_its_prunings_found_and_why_they_ended() -> None:
    scene = tiny_scene()
    method = create_method("2dgs", {"prune_error": 0.05, "prune_from": 3_000, "densify_until": 0}, seed=1)
    assert isinstance(method, GaussianMethod)
    method.initialize(scene, 120)
    prunings = method.parts["prunings"]
    assert isinstance(prunings, Prunings)
    sizes = [len(scene.points)]
    with torch.no_grad():
        for step in (30, 60, 90):
            prunings.bound.best = {name: value - 5 for name, value in prunings.bound.best.items()}  # all is allowed
            if step == 90:
                prunings.bound.best["PSNR"] += 50
            befall(method, step, {"prune"})
            sizes.append(method.primitives()["base"])
    assert sizes[0] > sizes[1] >= sizes[2] == sizes[3]
    (note,) = method.notes
    assert note.startswith(f"prunings: 2: {sizes[3]:,} of {sizes[0]:,} primitives are left; they ended as PSNR fell by")
