"""What prunings may cost: how views' quality is told, and when it ends them."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from schedules import befall
from torch import Tensor

from envgs_bench.core import Rendering, Statistics, View
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.gaussians.pruning import Prunings
from envgs_bench.methods.gaussians.pruning_bound import BOUNDS, INSIDE, LPIPS, PruningBound, quality_of
from envgs_bench.methods.registry import create_method
from envgs_bench.metrics.psnr import psnr
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


def largest_difference(color: Tensor, target: Tensor) -> Tensor:
    """In place of LPIPS, whose weights a test may not have."""
    return (color - target).abs().max()


def test_quality_is_what_the_metrics_say_and_weighs_reflections_by_beta() -> None:
    view, beta = noise_view(), torch.zeros(SIDE, SIDE)
    beta[:8], beta[8:16] = 0.5, 0.25
    color = view.rgb().clone()
    color[:16] += 0.1
    color[8:] += 0.02
    found = quality_of([(drawing(color, beta), view)], largest_difference)
    assert found["PSNR"] == pytest.approx(psnr(color, view.rgb()), abs=1e-4)
    assert found[LPIPS] == pytest.approx(0.12, abs=1e-5)
    inside = (0.5 * 0.1**2 + 0.25 * 0.12**2) / 0.75
    assert found[INSIDE] == pytest.approx(-10 * torch.tensor(inside).log10().item(), abs=1e-4)
    assert set(found) == set(BOUNDS)
    several = quality_of([(drawing(color), view), (drawing(view.rgb()), view)], largest_difference)
    assert several[LPIPS] == pytest.approx(0.06, abs=1e-5)
    assert set(quality_of([(drawing(color), view)], None)) == {"PSNR"}


def test_the_bound_is_from_the_best_that_views_have_been() -> None:
    bound = PruningBound()
    seen = [(20.0, 0.3), (26.0, 0.2), (25.91, 0.2024)]  # better, then worse by 0.09 and by 0.0024, as allowed
    assert [bound.allows({"PSNR": psnr, LPIPS: lpips}) for psnr, lpips in seen] == [True, True, True]
    assert not bound.allows({"PSNR": 25.89, LPIPS: 0.2026})  # by 0.11 and 0.0026 from the best
    assert bound.seen == "PSNR 25.89 (at best 26), LPIPS 0.2026 (at best 0.2)"
    assert bound.beyond == "PSNR 0.11, more than 0.1 and LPIPS 0.0026, more than 0.0025"
    assert bound.allows({"PSNR": 25.91, LPIPS: 0.2024})  # training won back what was too much
    assert bound.beyond == ""


@pytest.mark.parametrize("worse", [{"PSNR": 25.0}, {INSIDE: 19.0}, {LPIPS: 0.3}])
def test_each_number_alone_keeps_prunings_off(worse: dict[str, float]) -> None:
    bound, seen = PruningBound(), {"PSNR": 26.0, INSIDE: 20.0, LPIPS: 0.2}
    assert bound.allows(seen)
    assert not bound.allows(seen | worse)
    assert bound.beyond.startswith(next(iter(worse)))


def pruning_method(lpips: Any = None) -> tuple[GaussianMethod, Prunings]:
    """In a run of 120 steps, where prunings are due after step 30, 60 and 90."""
    method = create_method("2dgs", {"prune_error": 0.05, "prune_from": 3_000, "densify_until": 0}, seed=1)
    assert isinstance(method, GaussianMethod)
    assert method.needs.lpips
    if lpips is not None:
        method.perceptual["lpips"] = lpips
    method.initialize(tiny_scene(), 120)
    prunings = method.parts["prunings"]
    assert isinstance(prunings, Prunings)
    return method, prunings


def test_a_run_says_what_its_prunings_found_and_why_one_was_left_out() -> None:
    method, prunings = pruning_method()
    sizes = [len(tiny_scene().points)]
    for step in (30, 60, 90):
        prunings.bound.best = {name: value - 5 for name, value in prunings.bound.best.items()}  # all is allowed
        if step == 60:
            prunings.bound.best["PSNR"] += 50
        befall(method, step, {"prune"})
        sizes.append(method.primitives()["base"])
        (note,) = method.notes
        assert ("; the last was left out, as training views lost PSNR " in note) == (step == 60)
        prunings.bound.best["PSNR"] = 0.0
    assert sizes[0] > sizes[1] == sizes[2] > sizes[3]
    assert note.startswith(
        f"prunings: 2 of 3: {sizes[3]:,} of {sizes[0]:,} primitives are left; before it they had PSNR"
    )
    assert note.endswith("; LPIPS was not asked, as VGG-16's weights are not here")


def test_a_run_asks_for_lpips_where_it_prunes() -> None:
    asked = []

    def lpips(color: Tensor, target: Tensor) -> Tensor:
        asked.append(color.shape)
        return largest_difference(color, target)

    assert not create_method("2dgs").needs.lpips
    method, prunings = pruning_method(lpips)
    befall(method, 30, {"prune"})
    assert len(asked) == len(tiny_scene().train)  # a view each, as they are few
    prunings.bound.best = {"PSNR": 0.0, LPIPS: 0.0}
    before = method.primitives()
    befall(method, 60, {"prune"})
    assert method.primitives() == before
    (note,) = method.notes
    assert note.startswith("prunings: 1 of 2: ")
    assert "training views lost LPIPS" in note
