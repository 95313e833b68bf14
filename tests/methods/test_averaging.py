"""What is trained, averaged over the last steps of a run: against the mean of the same steps, one by one."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from schedules import trained_by
from small_methods import SMALL
from torch import Tensor

from envgs_bench.cli.composition import composed
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.settings import GaussianSettings
from envgs_bench.methods.training.averaging import ParameterAverage
from envgs_bench.methods.training.schedule import Every
from envgs_bench.testing import tiny_scene

STEPS = 40
KINDS = ("2dgs", "envmap", "envgs", "3igs")  # of a set; and a map, a second set, a network


def trained(kind: str, average_from: int, reset_at: int = 0) -> list[dict[str, Tensor]]:
    """All that a method trains, after each step of its run, with reflections from step 5 on where it has any."""
    settings = {**SMALL[kind], "backend": "cpu", "rules": {"average_from": average_from}}
    method = create_method(kind, settings | ({"warm_up": 3_000} if kind.startswith("env") else {}))
    scene = tiny_scene()
    method.initialize(scene, STEPS)
    reset = Every("reset", partial(method.model.reset_opacity, "base"), also=lambda step: step == reset_at)
    method.runner.events = [*method.runner.events, reset]
    after = []
    for step in range(1, STEPS + 1):
        method.training_step(scene.train[step % len(scene.train)], step)
        after.append({name: values.detach().clone() for name, values in trained_by(method).items()})
    return after


def assert_mean(found: dict[str, Tensor], steps: list[dict[str, Tensor]]) -> None:
    for name, values in found.items():
        expected = torch.stack([step[name].double() for step in steps]).mean(0)
        torch.testing.assert_close(values.double(), expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_ends_with_the_mean_of_its_last_steps(kind: str) -> None:
    plain, averaged = (trained(kind, average_from) for average_from in (0, 24_000))  # of 30,000: after 32 of 40
    for before, step in zip(averaged[:-1], plain[:-1], strict=True):  # training itself is the same
        assert all(torch.equal(before[name], values) for name, values in step.items())
    assert_mean(averaged[-1], plain[32:])
    for name, values in averaged[-1].items():
        assert not values.numel() or not torch.equal(values, plain[-1][name]), name


def test_an_opacity_reset_begins_another_mean() -> None:
    """Opacities of before it would bring back what it has made transparent."""
    plain, averaged = (trained("2dgs", average_from, reset_at=36) for average_from in (0, 24_000))
    assert_mean(averaged[-1], plain[35:])


@pytest.mark.parametrize("name", ["2dgs", "3dgs", "3dgs_dr", "3igs", "envgs_paper", "envgs_released", "envmap_paper"])
def test_methods_as_published_average_nothing(name: str) -> None:
    assert settings_of(name).rule.average_from == 0


@pytest.mark.parametrize("name", ["envgs", "envmap", "2dgs_tuned", "3dgs_tuned", "3dgs_dr_tuned", "3igs_tuned"])
def test_the_others_average_their_last_twelfth(name: str) -> None:
    assert settings_of(name).rule.average_from == 27_600


def settings_of(name: str) -> GaussianSettings:
    method = composed([f"method={name}"]).method
    return create_method(method.kind, method.settings).settings


def test_rows_that_come_or_go_begin_another_mean() -> None:
    average = ParameterAverage()
    for size, value in ((3, 1.0), (3, 3.0), (2, 5.0), (2, 7.0)):
        parameters = {"means": torch.full((size, 3), value, requires_grad=True)}
        average.add(parameters)
    average.move(parameters)
    assert torch.equal(parameters["means"], torch.full((2, 3), 6.0))


def test_a_mean_goes_on_after_an_interruption() -> None:
    whole, first, second = ParameterAverage(), ParameterAverage(), ParameterAverage()
    values = [{"means": torch.full((2, 3), value)} for value in (1.0, 2.0, 6.0)]
    for step in values:
        whole.add(step)
    first.add(values[0]), first.add(values[1])
    second.restore(first.state(), torch.device("cpu"))
    second.add(values[2])
    moved = [{"means": torch.zeros(2, 3)} for _ in range(2)]
    whole.move(moved[0]), second.move(moved[1])
    assert torch.equal(moved[0]["means"], moved[1]["means"])
    assert torch.equal(moved[0]["means"], torch.full((2, 3), 3.0))
