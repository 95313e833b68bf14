"""MCMC growth: what parts show of a whole, that the dead move and the set fills its limit, and noise that is gated."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from mirror_ball import gain_of_training, mirror_ball
from schedules import steps_of_events
from scipy.integrate import quad
from torch import Tensor

from envgs_bench.core.torch.rotation import rotation_matrices
from envgs_bench.methods.gaussians.densification import DensificationRecord
from envgs_bench.methods.gaussians.parameters import GaussianParameters, LearningRates, inverse_sigmoid
from envgs_bench.methods.gaussians.relocation import (
    MOST_SHARES,
    NOISE,
    PositionNoise,
    relocate,
    shared,
)
from envgs_bench.methods.registry import create_method
from envgs_bench.testing import check_method, tiny_scene

SETTINGS: dict[str, Any] = {"max_primitives": 260, "densify_until": 25_000, "rules": {"growth": "mcmc"}}


def parameters_of(opacities: Tensor, axes: int = 2) -> GaussianParameters:
    generator = torch.Generator().manual_seed(3)
    count = len(opacities)
    tensors = {
        "means": torch.randn(count, 3, generator=generator),
        "quaternions": torch.randn(count, 4, generator=generator),
        "log_scales": torch.randn(count, axes, generator=generator) * 0.3 - 1,
        "opacity_logits": inverse_sigmoid(opacities),
        "sh_dc": torch.randn(count, 1, 3, generator=generator),
        "sh_rest": torch.zeros(count, 0, 3),
    }
    return GaussianParameters(tensors, LearningRates(), 1.0)


@pytest.mark.parametrize("opacity", [0.02, 0.5, 0.97])
@pytest.mark.parametrize("shares", [1, 2, 7, MOST_SHARES])
def test_parts_stop_what_the_whole_did_along_a_line(opacity: float, shares: int) -> None:
    """By quadrature of what that many Gaussians in one place stop, from front to back."""
    whole = torch.tensor([opacity]), torch.tensor([[0.3, 0.7]])
    opacities, scales = shared(*whole, torch.tensor([shares]))
    part = float(opacities[0].double())
    assert 1 - (1 - part) ** shares == pytest.approx(opacity, rel=1e-4)
    for scale, before in zip(scales[0].tolist(), (0.3, 0.7), strict=True):
        stopped = quad(lambda x, s=scale: 1 - (1 - part * math.exp(-x * x / (2 * s * s))) ** shares, -9, 9)[0]
        assert stopped == pytest.approx(opacity * before * math.sqrt(2 * math.pi), rel=1e-3)


def test_the_dead_move_to_the_living_and_the_set_grows_by_a_twentieth_to_its_limit() -> None:
    opacities = torch.full((100,), 0.4)
    opacities[10:20] = 0.001
    parameters = parameters_of(opacities)
    before = parameters.detached()["means"].clone()
    relocate(parameters, 1_000, torch.Generator().manual_seed(0))
    means = parameters.detached()["means"]
    assert len(parameters) == 105
    kept = torch.arange(100)[(opacities > 0.005)]
    assert torch.equal(means[kept], before[kept])
    for row in (*range(10, 20), *range(100, 105)):
        assert (means[row] == before[kept]).all(1).any()
    assert (parameters.detached()["opacity_logits"].sigmoid() > 0.005).all()
    relocate(parameters, 106, torch.Generator().manual_seed(0))
    assert len(parameters) == 106
    relocate(parameters, 50, torch.Generator().manual_seed(0))
    assert len(parameters) == 50


def test_opacity_is_how_likely_a_primitive_is_drawn() -> None:
    """Of two, one thrice as opaque: the dead are shared three to one."""
    opacities = torch.full((4_002,), 0.001)
    opacities[:2] = torch.tensor([0.6, 0.2])
    parameters = parameters_of(opacities)
    before = parameters.detached()["means"][:2].clone()
    relocate(parameters, 4_002, torch.Generator().manual_seed(1))
    share = (parameters.detached()["means"] == before[0]).all(1).float().mean()
    assert float(share) == pytest.approx(0.75, abs=0.03)


def guide_of(gradients: Tensor, weights: Tensor, steps: float = 2.0) -> DensificationRecord:
    record = DensificationRecord(len(gradients), gradients.device)
    record.gradients, record.weights, record.steps = gradients, weights, torch.full_like(gradients, steps)
    return record


def test_guided_growth_draws_by_opacity_times_gradient() -> None:
    """Of two, alike opaque, one has thrice the other's gradient: the dead are shared three to one."""
    opacities = torch.full((4_002,), 0.001)
    opacities[:2] = 0.5
    parameters = parameters_of(opacities)
    before = parameters.detached()["means"][:2].clone()
    gradients = torch.zeros(4_002)
    gradients[:2] = torch.tensor([0.3, 0.1])
    relocate(parameters, 4_002, torch.Generator().manual_seed(1), guide_of(gradients, torch.ones(4_002)))
    distances = torch.cdist(parameters.detached()["means"][2:], before)
    assert float((distances[:, 0] < distances[:, 1]).float().mean()) == pytest.approx(0.75, abs=0.05)


def test_guided_growth_moves_what_weighs_least_of_what_was_drawn_and_copies_start_apart() -> None:
    """Of forty as opaque, two weigh least and one was never drawn; a twentieth is moved, and a twentieth grows."""
    parameters = parameters_of(torch.full((40,), 0.5))
    before = parameters.detached()["means"].clone()
    weights = torch.linspace(1.0, 2.0, 40)
    weights[[3, 4, 5]] = 0.0
    record = guide_of(torch.ones(40), weights)
    record.steps[5] = 0
    relocate(parameters, 1_000, torch.Generator().manual_seed(1), record)
    means = parameters.detached()["means"]
    assert len(parameters) == 42
    moved = torch.nonzero((means[:40] != before).any(1))[:, 0].tolist()
    assert moved == [3, 4]
    assert not (means[[3, 4, 40, 41], None] == before).all(2).any()


def test_what_guided_growth_shares_has_smaller_scales_than_equal_parts_in_one_place() -> None:
    """A dead one moves to one of scale 0.2: both have equal parts' ÷ 1.3, 0.7 of such an offset apart."""
    distances = []
    for seed in range(200):
        parameters = parameters_of(torch.tensor([0.5, 0.001]))
        parameters.tensors["log_scales"].data.fill_(math.log(0.2))
        guide = guide_of(torch.ones(2), torch.tensor([1.0, 0.0]))
        relocate(parameters, 2, torch.Generator().manual_seed(seed), guide)
        tensors = parameters.detached()
        equal = float(shared(torch.tensor([0.5]), torch.tensor([[0.2, 0.2]]), torch.tensor([2]))[1][0, 0])
        assert tensors["log_scales"].exp().flatten().tolist() == pytest.approx([equal / 1.3] * 4, rel=1e-5)
        distances.append(float((tensors["means"][1] - tensors["means"][0]).norm()))
    assert sum(d * d for d in distances) / 200 == pytest.approx(2 * (0.7 * equal / 1.3) ** 2, rel=0.25)


@pytest.mark.parametrize("gradients", [0.0, 1.0])
def test_without_any_gradient_of_what_stays_guided_growth_draws_by_opacity(gradients: float) -> None:
    """Of 20 alike opaque, all are still, or one has a gradient that weighs least and moves: others are drawn from."""
    sources = set()
    for seed in range(40):
        parameters = parameters_of(torch.full((20,), 0.5))
        before = parameters.detached()["means"].clone()
        guide = guide_of(torch.zeros(20), torch.linspace(1, 2, 20))
        guide.gradients[0] = gradients
        relocate(parameters, 20, torch.Generator().manual_seed(seed), guide)
        sources.add(int((parameters.detached()["means"][0] - before).norm(dim=1).argmin()))
    assert len(sources) > 10


def test_moments_start_anew_where_opacities_were_shared() -> None:
    parameters = parameters_of(torch.tensor([0.9, 1e-4, 0.9, 0.9]))
    sum(value.sum() for value in parameters.tensors.values()).backward()
    parameters.optimizer.step()
    relocate(parameters, 4, torch.Generator().manual_seed(0))
    moments = parameters.optimizer.state[parameters.tensors["means"]]["exp_avg"].abs().sum(1)
    twins = (parameters.detached()["means"] == parameters.detached()["means"][1]).all(1)
    assert int(twins.sum()) == 2
    assert torch.equal(moments == 0, twins)


def test_noise_lies_in_the_plane_of_transparent_surfels_alone() -> None:
    parameters = parameters_of(torch.tensor([0.9, 1e-5] * 500))
    before = parameters.detached()["means"].clone()
    noise = PositionNoise(torch.device("cpu"), 0)
    noise.draw(1_000, 1e-6)
    noise.move(parameters.tensors, torch.tensor(False))
    assert torch.equal(parameters.detached()["means"], before)
    noise.move(parameters.tensors, torch.tensor(True))
    moved = parameters.detached()["means"] - before
    assert moved[::2].abs().max() < 1e-6
    axes = rotation_matrices(parameters.detached()["quaternions"])
    local = torch.einsum("nij,ni->nj", axes, moved)[1::2]
    variances = (2 * parameters.detached()["log_scales"][1::2]).exp()
    assert local[:, 2].abs().max() < 1e-5
    spread = (local[:, :2] / variances).std(0)
    torch.testing.assert_close(spread, torch.full((2,), NOISE * 1e-6 * 0.6225), rtol=0.1, atol=0)  # sigmoid(0.5)


def test_nothing_is_reset_and_growth_ends_when_settings_say() -> None:
    method = create_method("2dgs", SETTINGS)
    method.initialize(tiny_scene(), 30_000)
    found = steps_of_events(method, 30_000)
    assert set(found) == {"densify_base"}
    assert found["densify_base"] == list(range(600, 25_000, 100))


@pytest.mark.parametrize("growth", ["mcmc", "guided"])
def test_a_size_limit_is_asked_for(growth: str) -> None:
    with pytest.raises(ValueError, match=f"growth {growth} fills a size limit: set max_primitives"):
        create_method("3dgs", {"rules": {"growth": growth}})


@pytest.mark.parametrize("growth", ["mcmc", "guided"])
@pytest.mark.parametrize(("kind", "steps"), [("2dgs", 40), ("3dgs", 120), ("envgs", 40)])
def test_methods_that_grow_so_conform(kind: str, steps: int, growth: str) -> None:
    """Of 120 steps growths lie in either half, so that an interrupted training has to draw the same numbers."""
    own = {"env_grid": 2} if kind == "envgs" else {}
    rules = {"growth": growth, "average_from": 0}
    check_method(kind, {**SETTINGS, **own, "rules": rules}, steps=steps)


@pytest.mark.parametrize("growth", ["mcmc", "guided"])
def test_a_ball_is_learned_by_a_set_that_fills_its_limit(growth: str) -> None:
    scene = mirror_ball()
    method = create_method("2dgs", {**SETTINGS, "max_primitives": 700, "rules": {"growth": growth}})
    method.initialize(scene, 150)
    assert gain_of_training(method, scene, 150) > 3
    assert method.primitives()["base"] == 700
