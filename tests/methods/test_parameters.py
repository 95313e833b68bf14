"""Rows of a trained set and Adam's moments belong together."""

import pytest
import torch

from envgs_bench.methods.gaussians.initialization import initial_tensors
from envgs_bench.methods.gaussians.parameters import (
    SH_DC,
    GaussianParameters,
    LearningRates,
    primitive_bytes,
    sh_from_rgb,
)


def make_parameters(n: int = 6, beta: float | None = 0.2) -> GaussianParameters:
    generator = torch.Generator().manual_seed(1)
    tensors = initial_tensors(
        torch.randn(n, 3, generator=generator),
        torch.rand(n, 3, generator=generator),
        torch.randn(n, 4, generator=generator),
        axes=2,
        sh_degree=2,
        opacity=0.1,
        beta=beta,
        radius=2.0,
    )
    return GaussianParameters(tensors, LearningRates(), radius=2.0)


def step_with_distinct_gradients(parameters: GaussianParameters) -> None:
    for value in parameters.tensors.values():
        rows = torch.arange(1.0, len(value) + 1).reshape(-1, *[1] * (value.ndim - 1))
        value.grad = rows * torch.ones_like(value)
    parameters.optimizer.step()


def keep(parameters: GaussianParameters, rows: torch.Tensor) -> None:
    draft = parameters.draft()
    draft.keep(rows)
    parameters.become(draft)


def append(parameters: GaussianParameters, rows: dict[str, torch.Tensor]) -> None:
    draft = parameters.draft()
    draft.append(rows)
    parameters.become(draft)


def moments(parameters: GaussianParameters, name: str) -> torch.Tensor:
    return parameters.optimizer.state[parameters.tensors[name]]["exp_avg"]


def test_activated_values():
    parameters = make_parameters()
    gaussians = parameters.gaussians()
    torch.testing.assert_close(gaussians.opacities, torch.full((6,), 0.1))
    torch.testing.assert_close(gaussians.extras, torch.full((6, 1), 0.2))
    torch.testing.assert_close(gaussians.scales.log(), parameters.tensors["log_scales"])
    assert gaussians.sh.shape == (6, 9, 3)
    assert parameters.gaussians(sh_degree=1).sh.shape == (6, 4, 3)


@pytest.mark.parametrize(
    "scales",
    [
        [[4e-4, 0.5], [0.2, 0.2], [7e-3, 6e-6], [0.9, 1e-3]],  # the second is round, the last 900 times as long as wide
        [[1e-4, 0.5, 4e-4], [0.2, 1e-6, 0.2], [1e-8, 7e-3, 6e-6], [0.9, 1e-3, 1e-3]],  # the second is a disk
    ],
)
def test_degenerate_ones_are_long_against_their_second_axis(scales: list[list[float]]) -> None:
    axes = torch.tensor(scales)
    tensors = make_parameters(len(axes)).tensors | {"log_scales": axes.log()}
    assert float(GaussianParameters(tensors, LearningRates(), radius=2.0).degenerate()) == 0.5


def test_constant_sh_shows_its_color():
    rgb = torch.tensor([[0.1, 0.5, 0.9]])
    dc, rest = sh_from_rgb(rgb, 2)
    torch.testing.assert_close(dc[:, 0] * SH_DC + 0.5, rgb)
    assert rest.shape == (1, 8, 3)
    assert not rest.any()


def test_moments_follow_the_rows_that_stay():
    parameters = make_parameters()
    step_with_distinct_gradients(parameters)
    before = {
        name: (value.detach().clone(), moments(parameters, name).clone()) for name, value in parameters.tensors.items()
    }
    rows = torch.tensor([4, 1, 2])
    keep(parameters, rows)
    for name, (values, moment) in before.items():
        assert torch.equal(parameters.tensors[name], values[rows]), name
        assert torch.equal(moments(parameters, name), moment[rows]), name
        assert parameters.tensors[name].is_leaf
        assert parameters.tensors[name].requires_grad


def test_new_rows_start_without_moments():
    parameters = make_parameters()
    step_with_distinct_gradients(parameters)
    old = moments(parameters, "means").clone()
    append(parameters, parameters.draft().rows(torch.tensor([0, 5])))
    assert len(parameters) == 8
    assert torch.equal(moments(parameters, "means")[:6], old)
    assert not moments(parameters, "means")[6:].any()
    torch.testing.assert_close(parameters.tensors["means"][6:], parameters.tensors["means"][[0, 5]])


def test_adam_goes_on_after_a_change_as_if_the_other_rows_had_never_existed():
    whole, changed = make_parameters(), make_parameters()
    rows = torch.tensor([0, 2, 3])
    for parameters in (whole, changed):
        step_with_distinct_gradients(parameters)
    keep(changed, rows)
    for _ in range(3):
        for parameters, index in ((whole, torch.arange(6)), (changed, rows)):
            for value in parameters.tensors.values():
                shape = (-1, *[1] * (value.ndim - 1))
                value.grad = (index.float() - 2.5).reshape(shape) * torch.ones_like(value)
            parameters.optimizer.step()
    for name in whole.tensors:
        torch.testing.assert_close(whole.tensors[name][rows], changed.tensors[name])


def test_replace_forgets_the_fields_moments_only():
    parameters = make_parameters()
    step_with_distinct_gradients(parameters)
    parameters.replace("opacity_logits", torch.full((6,), -3.0))
    assert torch.equal(parameters.tensors["opacity_logits"].detach(), torch.full((6,), -3.0))
    assert not moments(parameters, "opacity_logits").any()
    assert moments(parameters, "means").all()


def test_learning_rates_are_the_recipes():
    parameters = make_parameters()
    rates = {group["name"]: group["lr"] for group in parameters.optimizer.param_groups}
    assert rates == {
        "means": 1.6e-4 * 2.0,
        "quaternions": 1e-3,
        "log_scales": 5e-3,
        "opacity_logits": 5e-2,
        "sh_dc": 2.5e-3,
        "sh_rest": 2.5e-3 / 20,
        "beta_logits": 1e-2,
    }


def test_size_counts_every_stored_float():
    assert make_parameters(6, beta=0.2).size_bytes == 6 * 4 * (3 + 4 + 2 + 1 + 27 + 1)
    assert make_parameters(6, beta=None).size_bytes == 6 * 4 * (3 + 4 + 2 + 1 + 27)
    assert (primitive_bytes(2, 2, True), primitive_bytes(3, 3, False)) == (4 * 38, 4 * 59)


def test_an_empty_set_takes_steps_and_rows():
    parameters = make_parameters()
    rows = parameters.draft().rows(torch.tensor([1]))
    keep(parameters, torch.zeros(6, dtype=torch.bool))
    step_with_distinct_gradients(parameters)
    append(parameters, rows)
    step_with_distinct_gradients(parameters)
    assert len(parameters) == 1
    assert torch.isfinite(parameters.tensors["means"]).all()
