"""A pilot run on reflections: it tells a mirror from paint, leaves alone what it keeps, and makes others 2DGS."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from fakes.runs import set_environment
from mirror_ball import mirror_ball, sky
from sweeps import one_run
from tuned_baselines import TUNED

from envgs_bench.core import Scene, View
from envgs_bench.methods import envgs
from envgs_bench.methods.envgs import EnvGS, EnvGSSettings
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.method import Budget
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.training import pilot_run, reflection_pilot
from envgs_bench.methods.training.pilot_run import SHORTEST_RUN
from envgs_bench.methods.training.reflection_pilot import LEAST_GAIN, LEAST_WEIGHT, PLAIN, ReflectionOutcome
from envgs_bench.testing import tiny_scene

SMALL = {"env_grid": 3, "env_far_count": 50, "reflection_pilot": True}
STEPS = 90  # densified every 30; from step 9 on reflections


def along_normals(settings: EnvGSSettings) -> EnvGS:
    """The control of a pilot run."""
    method = EnvGS(settings)
    method.reflection.rays_along = "normal"
    return method


def painted(scene: Scene) -> Scene:
    """The ball with a texture about as fine as what it mirrored, which is the same from everywhere."""

    def repainted(view: View) -> View:
        assert view.normal is not None
        color = torch.where(view.masks["reflective"][..., None], sky(4 * view.normal), 0.0)
        return replace(view, image=(255 * color).round().byte())

    return replace(scene, train=[repainted(view) for view in scene.train])


@pytest.mark.parametrize("paints", [False, True])
def test_a_mirror_is_told_from_paint(paints: bool) -> None:
    scene = painted(mirror_ball()) if paints else mirror_ball()
    settings = EnvGSSettings(env_grid=6, env_far_count=300)
    found = reflection_pilot.reflection_pilot(scene, EnvGS(settings), along_normals(settings))
    if paints:
        assert found.weight < LEAST_WEIGHT / 1.5
        assert found.gain < LEAST_GAIN - 0.1
    else:
        assert found.weight > 2 * LEAST_WEIGHT
        assert found.gain > LEAST_GAIN + 1.4
    assert found.reflects is not paints


@pytest.mark.parametrize(
    ("weight", "gain", "reflects"),
    [(0.84, 0.39, False), (0.86, -1.0, True), (0.5, 0.41, True), (math.nan, math.nan, True)],
)
def test_either_of_both_numbers_shows_a_reflection(weight: float, gain: float, reflects: bool) -> None:
    found = ReflectionOutcome(weight, gain)
    assert found.reflects is reflects
    assert f"{weight:.2f} times" in found.sentence
    assert f"{gain:+.2f} dB" in found.sentence
    assert ("2DGS" in found.sentence) is not reflects


@pytest.fixture
def short_runs(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Runs of any length begin with a pilot run, of few steps."""
    monkeypatch.setattr(envgs, "SHORTEST_RUN", 0)
    monkeypatch.setattr(pilot_run, "SCHEDULE", 60)
    monkeypatch.setattr(pilot_run, "STEPS", 9)
    return monkeypatch


def finds_nothing(monkeypatch: pytest.MonkeyPatch) -> list[Scene]:
    """Pilot runs find from now on that nothing reflects; the scenes that they are made on."""
    tried = []

    def found(scene: Scene, *_: Any) -> ReflectionOutcome:
        tried.append(scene)
        return ReflectionOutcome(0.5, -1.0)

    monkeypatch.setattr(envgs, "reflection_pilot", found)
    return tried


def trained(kind: str, budget: Budget | None = None, **settings: Any) -> GaussianMethod:
    method = create_method(kind, settings, seed=1)
    assert isinstance(method, GaussianMethod)
    if budget is not None:
        method.limit(budget)
    scene = tiny_scene()
    method.initialize(scene, STEPS)
    for step in range(1, STEPS + 1):
        method.training_step(scene.train[step % len(scene.train)], step)
    return method


def assert_same_sets(a: GaussianMethod, b: GaussianMethod) -> None:
    assert a.model.sets.keys() == b.model.sets.keys()
    for name in a.model.sets:
        tensors, others = (method.model.sets[name].parameters.tensors for method in (a, b))
        assert tensors.keys() == others.keys()
        for field, values in tensors.items():
            assert torch.equal(values, others[field])


def test_a_run_that_keeps_its_reflections_is_to_the_last_bit_what_it_is_without_a_trial(
    short_runs: pytest.MonkeyPatch,
) -> None:
    short_runs.setattr(reflection_pilot, "LEAST_WEIGHT", 0.0)
    kept, untried = (trained("envgs", **SMALL | {"reflection_pilot": tries}) for tries in (True, False))
    assert_same_sets(kept, untried)
    assert set(kept.model.sets) == {"base", "env"}
    assert torch.equal(kept.generator.get_state(), untried.generator.get_state())
    assert (len(kept.notes), len(untried.notes)) == (1, 0)


def test_a_run_that_reflects_late_is_tried_as_any_other(short_runs: pytest.MonkeyPatch) -> None:
    method = create_method("envgs", SMALL | {"warm_up": 29_000})
    method.initialize(tiny_scene(), STEPS)
    assert "times the weight" in method.notes[0]


@pytest.mark.parametrize("budget", [None, Budget(primitives=300), Budget(mb=0.03)])
def test_where_nothing_reflects_envgs_is_2dgs_to_the_last_bit(
    budget: Budget | None, short_runs: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    finds_nothing(short_runs)
    plain, baseline = trained("envgs", budget, **SMALL), trained("2dgs", budget, **TUNED)
    assert_same_sets(plain, baseline)
    camera = tiny_scene().test[0].camera
    drawn = plain.render(camera)
    assert torch.equal(drawn.color, baseline.render(camera).color)
    assert not drawn.layers
    assert plain.model_bytes() == baseline.model_bytes()
    assert "2DGS" in plain.notes[0]

    plain.save(tmp_path)
    loaded = create_method("envgs", SMALL)
    loaded.load(tmp_path)
    assert torch.equal(loaded.render(camera).color, drawn.color)


def test_an_interrupted_run_is_tried_once(short_runs: pytest.MonkeyPatch) -> None:
    tried = finds_nothing(short_runs)
    first, second = (create_method("envgs", SMALL, seed=1) for _ in range(2))
    assert isinstance(first, EnvGS)
    assert isinstance(second, EnvGS)
    scene = tiny_scene()
    first.initialize(scene, STEPS)
    second.resume(scene, STEPS, first.training_state())
    assert len(tried) == 1
    assert envgs.is_plain(second)
    assert second.notes == first.notes
    for step in (1, 2):
        for method in (first, second):
            method.training_step(scene.train[step], step)
    assert_same_sets(first, second)


@pytest.mark.parametrize(("steps", "asked", "tries"), [(SHORTEST_RUN - 1, True, 0), (SHORTEST_RUN, False, 0)])
def test_short_runs_and_those_that_are_told_not_to_have_no_trial(
    steps: int, asked: bool, tries: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = finds_nothing(monkeypatch)
    create_method("envgs", SMALL | {"reflection_pilot": asked}).initialize(tiny_scene(), steps)
    assert len(tried) == tries


def test_control_rays_are_as_many_and_leave_along_the_normals() -> None:
    scene, rays = tiny_scene(), {}
    camera = scene.test[0].camera
    for kind in (EnvGS, along_normals):
        method = kind(EnvGSSettings(**SMALL))
        method.initialize(scene, STEPS)
        with torch.no_grad():
            base = method.model.rasterize(camera, 1)
            rays[kind] = method.reflection.rays(base, camera, 1)
    (origins, mirrored, beta), (others, directions, weights) = rays.values()
    torch.testing.assert_close(others, origins)
    torch.testing.assert_close(weights, beta)
    torch.testing.assert_close(directions.norm(dim=-1), mirrored.norm(dim=-1))
    traced = directions.any(dim=-1)
    assert traced.any()
    torch.testing.assert_close(directions[traced], torch.nn.functional.normalize(base.normal, dim=-1)[traced])
    assert (directions - mirrored).abs().max() > 0.1


@pytest.mark.parametrize(("lean", "full"), [("envgs", "2dgs_tuned"), ("envgs_lean", "2dgs_lean")])
def test_what_becomes_plain_has_the_settings_of_tuned_2dgs(
    lean: str, full: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_environment(monkeypatch)
    method, baseline = (one_run("tuning", method=name).method.settings for name in (lean, full))
    unused = {"mono_loss"}
    shared = baseline.keys() & method.keys() - unused
    assert {key: (method | PLAIN)[key] for key in shared} == {key: baseline[key] for key in shared}
    assert PLAIN.keys() <= asdict(EnvGSSettings()).keys()
