"""What goes wrong while training is noticed, recorded, and the end where it is hopeless; a healthy run shows none."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fakes.methods import MeanColor, Settings
from torch import Tensor
from toy_scenes import rough_toys

from envgs_bench.core import Scene, View
from envgs_bench.datasets import load_scene
from envgs_bench.methods.method import Method, Monitor
from envgs_bench.methods.registry import create_method
from envgs_bench.records import TrainingWarning
from envgs_bench.stages import health
from envgs_bench.stages.health import Diverged, Health
from envgs_bench.stages.training import Training
from envgs_bench.testing import tiny_scene

TOY = {"kind": "toy", "width": 28, "height": 21, "views": 17, "supersampling": 1, "normal_noise": 5.0}
SMALL = {"env_grid": 6, "env_far_count": 200}
KINDS: dict[str, dict[str, Any]] = {"2dgs": {}, "3dgs": {}, "envmap": {"envmap_size": 16}, "envgs": SMALL}


class Scripted(MeanColor):
    """Reports what a test says of each step."""

    script: Callable[[int], Mapping[str, Any]]

    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        self.now: Mapping[str, Any] = {}

    def training_step(self, view: View, step: int) -> dict[str, float]:
        self.now = self.script(step)
        return {"loss": 1.0, "psnr": self.now.get("psnr", 60.0)}

    def primitives(self) -> dict[str, int]:
        return {"base": self.now.get("base", 1000), "env": self.now.get("env", 0)}

    @property
    def monitor(self) -> Monitor:
        return ScriptedMonitor(self)


class ScriptedMonitor(Monitor):
    def __init__(self, method: Scripted) -> None:
        self.method = method

    def last_maps(self) -> Mapping[str, Tensor]:
        now = self.method.now
        return {name: torch.full((4, 4), now[name]) for name in ("alpha", "beta") if name in now}

    def degenerate(self) -> Mapping[str, float]:
        return {"base": self.method.now.get("degenerate", 0.0)}

    def at_size_limit(self) -> Mapping[str, int]:
        return self.method.now.get("capped", {})


def scripted(script: Callable[[int], Mapping[str, Any]], tmp_path: Path, steps: int = 3000) -> list[TrainingWarning]:
    method = Scripted(Settings())
    method.script = script
    return warnings_of(method, tiny_scene(), steps, tmp_path)


def warnings_of(method: Method, scene: Scene, steps: int, folder: Path) -> list[TrainingWarning]:
    training = Training(method, scene, steps, seed=0)
    events: list[dict[str, Any]] = []
    training.run(folder / "curve.csv", events.append)
    told = [TrainingWarning.model_validate(event["warning"]) for event in events if "warning" in event]
    assert [w.message for w in told] == [w.message for w in training.health.warnings]
    return training.health.warnings


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    with rough_toys():
        return load_scene({**TOY, "scene": "chrome_room"}, tmp_path_factory.mktemp("cache"))


@pytest.mark.parametrize("kind", [pytest.param(k, marks=() if k == "envgs" else pytest.mark.slow) for k in KINDS])
def test_a_healthy_training_warns_of_nothing(kind: str, room: Scene, tmp_path: Path) -> None:
    assert warnings_of(create_method(kind, KINDS[kind]), room, 120, tmp_path) == []


def test_a_set_that_shrinks_or_doubles_in_one_step_is_noticed_with_the_step(tmp_path: Path) -> None:
    def script(step: int) -> dict[str, int]:
        return {"base": 1000 if step < 7 else 400 if step < 9 else 900, "env": 0 if step < 5 else 5000}

    found = scripted(script, tmp_path, 20)
    assert [(w.kind, w.step, w.part) for w in found] == [("set_shrinks", 7, "base"), ("set_doubles", 9, "base")]
    assert found[0].message == "from 1,000 to 400 primitives in one step"


def test_an_environment_may_lose_most_of_its_random_start_and_not_all_of_it(tmp_path: Path) -> None:
    assert scripted(lambda step: {"env": 22_000 if step < 7 else 9_000}, tmp_path, 20) == []
    (warning,) = scripted(lambda step: {"env": 22_000 if step < 7 else 2_000}, tmp_path, 20)
    assert (warning.kind, warning.part) == ("set_shrinks", "env")


def test_what_a_method_prunes_on_purpose_is_no_news(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ScriptedMonitor, "prunes", lambda self, step: step == 7)
    (warning,) = scripted(lambda step: {"base": 1000 if step < 7 else 400 if step < 9 else 150}, tmp_path, 20)
    assert (warning.kind, warning.step, warning.times) == ("set_shrinks", 9, 1)


def test_growth_as_densification_allows_it_and_small_sets_are_no_news(tmp_path: Path) -> None:
    assert scripted(lambda step: {"base": int(1000 * 1.1**step), "env": 10 + 40 * (step % 2)}, tmp_path, 30) == []


def test_a_run_without_any_primitive_left_ends_and_says_when(room: Scene, tmp_path: Path) -> None:
    method = create_method("2dgs", {"min_opacity": 1.1})  # every densification prunes all
    training = Training(method, room, 300, seed=0)
    with pytest.raises(Diverged, match="no primitive of the base set is left after step 30"):
        training.run(tmp_path / "curve.csv", lambda event: None)
    assert [(w.kind, w.step) for w in training.health.warnings] == [("set_shrinks", 30)]


def test_a_psnr_that_falls_and_stays_low_is_noticed_and_in_the_end_hopeless(tmp_path: Path) -> None:
    (warning,) = scripted(lambda step: {"psnr": 60.0 if step <= 1000 else 50.0}, tmp_path)
    assert (warning.kind, warning.step) == ("loss_climbs", 1400)
    assert warning.message == "a median PSNR of 50.0 dB over 50 steps, 60.0 dB before, for 400 steps"
    with pytest.raises(Diverged, match="it has been so for 2000 steps, up to step 3000"):
        scripted(lambda step: {"psnr": 60.0 if step <= 1000 else 50.0}, tmp_path, 4000)


def test_pictures_worse_than_one_color_are_noticed_and_in_the_end_hopeless(tmp_path: Path) -> None:
    scene = tiny_scene()
    colors = np.concatenate([view.image.numpy().reshape(1, -1, 3) for view in scene.train])
    deviations = colors.std(axis=1, keepdims=True) / 255
    psnr = np.median([-10 * np.log10((d**2).mean()) for d in deviations])
    assert scripted(lambda step: {"psnr": psnr + 2}, tmp_path) == []
    (warning,) = scripted(lambda step: {"psnr": psnr - 2}, tmp_path, 1900)
    assert (warning.kind, warning.step) == ("learns_nothing", 400)
    with pytest.raises(Diverged, match="where views in one color have"):
        scripted(lambda step: {"psnr": psnr - 2}, tmp_path)


def test_a_short_run_is_judged_by_half_of_it(tmp_path: Path) -> None:
    (warning,) = scripted(lambda step: {"psnr": 60.0 if step <= 100 else 50.0}, tmp_path, 300)
    assert (warning.kind, warning.step, warning.message[-9:]) == ("loss_climbs", 250, "150 steps")


def test_what_an_opacity_reset_does_is_healthy(tmp_path: Path) -> None:
    def script(step: int) -> dict[str, float]:
        after = step % 600
        return {"psnr": 12.0 if after < 250 else 60.0, "alpha": 0.01 if after < 250 else 0.9}

    assert scripted(script, tmp_path) == []


def test_pictures_that_become_empty_are_noticed(tmp_path: Path) -> None:
    (warning,) = scripted(lambda step: {"alpha": 0.9 if step < 500 else 0.001}, tmp_path, 1500)
    assert (warning.kind, warning.step) == ("alpha_vanishes", 850)
    with pytest.raises(Diverged, match=r"the picture's mean alpha is 0\.0010"):
        scripted(lambda step: {"alpha": 0.9 if step < 500 else 0.001}, tmp_path)


@pytest.mark.parametrize(
    ("beta", "reflective", "kind"),
    [
        (0.95, None, "beta_saturates"),
        (0.95, False, "beta_saturates"),
        (0.95, True, None),  # all of the picture is a mirror
        (0.001, True, "beta_vanishes"),
        (0.001, False, None),
        (0.001, None, None),  # who knows
        (0.3, True, None),
        (0.3, False, None),
    ],
)
def test_beta_is_held_against_what_reflects_where_that_is_known(
    beta: float, reflective: bool | None, kind: str | None
) -> None:
    method = Scripted(Settings())
    method.now = {"beta": beta}
    view = tiny_scene().train[0]
    if reflective is not None:
        view = replace(view, masks={"reflective": torch.full((4, 4), reflective)})
    watched = Health(method, 3000)
    for step in range(50, 1500, 50):
        watched.look(step, view)
    assert [w.kind for w in watched.warnings] == ([kind] if kind else [])


def test_degenerate_gaussians_are_noticed_once_they_last(tmp_path: Path) -> None:
    (warning,) = scripted(lambda step: {"degenerate": 0.12 if step > 500 or 100 < step < 300 else 0.0}, tmp_path, 1500)
    assert (warning.kind, warning.part, warning.step) == ("degenerate", "base", 900)
    assert "12.0%" in warning.message


def test_scales_that_run_away_make_degenerate_gaussians(room: Scene, tmp_path: Path) -> None:
    warned = warnings_of(create_method("2dgs", {"scale_lr": 0.3}), room, 200, tmp_path)
    assert [(warning.kind, warning.part) for warning in warned] == [("degenerate", "base")]


def test_a_set_held_back_by_its_cap_is_noticed_once_it_lasts(tmp_path: Path) -> None:
    script = lambda step: {"capped": {"env": 7_000} if step > 500 or 100 < step < 300 else {}}  # noqa: E731
    (warning,) = scripted(script, tmp_path, 1500)
    assert (warning.kind, warning.part, warning.step) == ("size_limit", "env", 900)
    assert "7,000 primitives" in warning.message


def test_caps_hold_the_sets_that_they_name_back(room: Scene, tmp_path: Path) -> None:
    caps = {"max_primitives": 500, "env_max_primitives": 400}
    warned = warnings_of(create_method("envgs", {**SMALL, **caps}), room, 200, tmp_path)
    limits = {warning.part: warning.message for warning in warned if warning.kind == "size_limit"}
    assert limits.keys() == {"base", "env"}
    assert "500 primitives" in limits["base"]
    assert "400 primitives" in limits["env"]


def test_a_cap_of_0_holds_no_set_back(room: Scene, tmp_path: Path) -> None:
    caps = {"max_primitives": 0, "env_max_primitives": 0}
    assert warnings_of(create_method("envgs", {**SMALL, **caps}), room, 100, tmp_path) == []


@pytest.mark.parametrize("kind", KINDS)
def test_which_gradient_was_not_finite_is_recorded(kind: str, room: Scene, tmp_path: Path) -> None:
    """One step's gradient is broken behind the loss's back: nothing but the gradient shows it."""
    method = create_method(kind, KINDS[kind])
    step_before = method.model.set_learning_rates

    def break_gradient(step: int) -> None:
        step_before(step)
        if step == 15:
            quaternions = method.model.sets["base"].parameters.tensors["quaternions"]
            quaternions.register_hook(lambda gradient: gradient * math.nan)

    method.model.set_learning_rates = break_gradient
    training = Training(method, room, 20, seed=0)
    training.run(tmp_path / "curve.csv", lambda event: None)
    (warning,) = training.health.warnings
    assert (warning.kind, warning.part) == ("non_finite", "base.quaternions")
    assert 15 <= warning.step <= 20
    assert int(method.skipped_steps) == 6  # the hook stays until the set is another


def test_which_loss_was_not_finite_is_recorded_with_its_step(room: Scene, tmp_path: Path) -> None:
    broken = [replace(v, normal=torch.full_like(v.normal, math.nan)) for v in room.train[:1]] + room.train[1:]
    found = warnings_of(create_method("envgs", SMALL), replace(room, train=broken), 30, tmp_path)
    (loss,) = [w for w in found if w.part == "mono"]
    assert loss.message == "the loss mono was nan, and the step skipped"
    assert loss.times == 2  # every view once in 14 steps, and each of the two within 30 steps
    assert {w.kind for w in found} == {"non_finite"}


def test_a_run_whose_every_gradient_is_lost_ends(tmp_path: Path) -> None:
    class Skips(MeanColor):
        def training_step(self, view: View, step: int) -> dict[str, float]:
            self.skipped_steps += step > 30
            return {"loss": 1.0}

    with pytest.raises(Diverged, match="20 steps in a row were skipped, up to step 50"):
        warnings_of(Skips(Settings()), tiny_scene(), 1000, tmp_path)


def test_now_and_then_a_skipped_step_ends_nothing(tmp_path: Path) -> None:
    class Skips(MeanColor):
        def training_step(self, view: View, step: int) -> dict[str, float]:
            self.skipped_steps += step % 2
            return {"loss": 1.0}

    training = Training(Skips(Settings()), tiny_scene(), 300, 0)
    training.run(tmp_path / "curve.csv", lambda event: None)
    assert training.method.skipped_steps == 150


def test_a_health_that_was_stored_judges_the_later_steps_as_the_first_would_have() -> None:
    method, view, steps = Scripted(Settings()), tiny_scene().train[0], 2000

    def judged(stored_after: int) -> Health:
        health, method.skipped_steps = Health(method, steps), 0
        for step in range(1, steps + 1):
            well = step < 1000
            lost = step in (1195, 1199, 1203, 1207)
            method.now = {"alpha": 0.9 if well else 0.001, "beta": 0.1 if well else 0.9}
            method.skipped_steps += lost
            health.count(step, {"base": 1000 if step < 1199 else 300, "env": 0})
            health.read(step, {"loss": math.nan if lost else 1.0, "psnr": 60.0 if well else 50.0 + step % 3})
            health.count_skips(step, 1)
            if health.due(step):
                health.look(step, view)
            if step == stored_after:
                stored = json.loads(json.dumps(health.state()))
                health = Health(method, steps)
                health.restore(stored)
        return health

    whole, restored = judged(0), judged(1199)
    assert {(w.kind, w.step) for w in whole.warnings} == {
        ("non_finite", 1195),
        ("set_shrinks", 1199),
        ("loss_climbs", 1400),
        ("alpha_vanishes", 1350),
        ("beta_saturates", 1350),
    }
    assert restored.warnings == whole.warnings
    assert restored.state() == whole.state()


def test_memory_that_runs_out_ends_the_run_before_the_system_does(
    room: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(health, "machine_memory", lambda: 1_000_000)
    training = Training(create_method("2dgs"), room, 100, seed=0)
    with pytest.raises(MemoryError, match=r"stopped after step 50 before the system would have"):
        training.run(tmp_path / "curve.csv", lambda event: None)
    assert [w.kind for w in training.health.warnings] == ["budget"]


def test_the_memory_that_a_process_holds_is_what_it_allocates() -> None:
    before = health.process_memory()
    held = torch.ones(50_000_000)
    assert health.process_memory() - before == pytest.approx(4 * held.numel(), rel=0.1)
    assert 0 < health.process_memory() < health.machine_memory()
