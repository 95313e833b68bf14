"""The schedule of a reference run, number by number, and that a short run leaves nothing out."""

import dataclasses
from functools import cache
from itertools import pairwise

import pytest
import torch
from rules import with_rules
from schedules import due

from envgs_bench.core import Camera, Scene, View
from envgs_bench.methods.lighting.disturbance import HOLD_FLOOR, PROPAGATE_HOLD
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.training.schedule import RECOVERY, Schedule, _disturbances

VIEW = View("view", Camera(torch.eye(4), torch.eye(3), 4, 4), torch.zeros(4, 4, 3, dtype=torch.uint8))
SCENE = Scene(
    "points", [VIEW], [VIEW], torch.rand(20, 3, generator=torch.Generator().manual_seed(0)), torch.zeros(20, 3)
)


def events(kind: str, steps: int, on_white: bool = False, **settings) -> dict[str, list[int]]:
    """For each event the steps of a run in which it happens, over a white background or not."""
    return dict(_events(kind, steps, on_white, **settings))


@cache
def _events(kind: str, steps: int, on_white: bool, **settings) -> dict[str, list[int]]:
    method = create_method(kind, with_rules(**settings))
    method.initialize(dataclasses.replace(SCENE, background=torch.full((3,), float(on_white))), steps)
    found: dict[str, list[int]] = {}
    for step in range(1, steps + 1):
        for name in due(method, step):
            found.setdefault(name, []).append(step)
    return found


def test_envgs_with_the_released_intervals_is_the_recipe_at_30000_steps():
    released = {"densify_every": 100, "env_densify_every": 500, "beta_reset_from": 6_000, "disturb_every": 1000}
    released |= {"densify_until": 21_000, "growth": "gradient"}
    found = events("envgs", 30_000, **released)
    assert found.pop("densify_base") == [*range(600, 3001, 100), *range(3500, 18_001, 500), *range(18_100, 21_000, 100)]
    assert found.pop("densify_env") == list(range(3500, 21_000, 500))
    thousands = [4, 5, 7, 8, 10, 11, 13, 14, 16, 17]
    assert found.pop("sabotage") == found.pop("propagate") == [1000 * k for k in thousands]
    assert found.pop("reset_base_opacity") == [3000, 6000, 9000, 12_000, 15_000, 18_000]
    assert found.pop("reset_beta") == [6000, 9000, 12_000, 15_000, 18_000]
    assert found.pop("reset_env_opacity") == [6000, 12_000, 18_000]
    assert not found


@pytest.mark.parametrize("kind", ["2dgs", "3dgs"])
def test_the_baselines_at_30000_steps_are_the_originals(kind):
    found = events(kind, 30_000)
    assert found == {
        "densify_base": list(range(600, 15_000, 100)),
        "reset_base_opacity": [3000, 6000, 9000, 12_000],
    }


@pytest.mark.parametrize("kind", ["2dgs", "3dgs"])
def test_over_white_the_baselines_reset_opacities_where_they_begin_to_grow(kind):
    at_30000, on_black = (events(kind, 30_000, on_white=on_white) for on_white in (True, False))
    assert at_30000["reset_base_opacity"] == [500, *on_black["reset_base_opacity"]]
    assert at_30000["densify_base"] == on_black["densify_base"]  # the first, at step 600, has 100 steps to recover
    short = events(kind, 6000, on_white=True)
    assert short["reset_base_opacity"] == [100, 600, 1200, 1800, 2400]
    assert short["densify_base"][0] == 210  # a multiple of 30, 100 steps after the reset
    assert "reset_base_opacity" not in events(kind, 800, on_white=True)  # nor has it any other: it is too short
    assert events(kind, 30_000, on_white=True, reset_on_white=False) == on_black


@pytest.mark.parametrize(("steps", "first"), [(30_000, 3000), (6000, 600), (800, 600)])
def test_the_baselines_prune_what_is_oversized_from_the_first_reset_on(steps, first):
    prunes, splits = (create_method(kind).policies(Schedule(steps), SCENE)["base"] for kind in ("3dgs", "envgs"))
    kept = [step for step in range(1, steps + 1) if prunes.oversized_at(step) == "keep"]
    assert kept == list(range(1, first + 1))
    assert prunes.oversized_at(steps) == ("prune" if steps > first else "keep")
    assert {splits.oversized_at(step) for step in (1, steps)} == {"split"}


def test_twice_the_steps_stretch_the_schedule():
    once, twice = (events("envgs", steps, disturb_every=1000) for steps in (30_000, 60_000))
    assert twice == {name: [2 * step for step in steps] for name, steps in once.items()}


@pytest.mark.parametrize(
    ("steps", "missing"),
    [(2000, set()), (300, {"sabotage", "propagate", "reset_base_opacity", "reset_beta", "reset_env_opacity"})],
)
def test_a_short_run_has_every_phase_that_it_can_recover_from(steps, missing):
    often = {"beta_reset_from": 6_000, "disturb_every": 1000, "densify_until": 18_000, "growth": "gradient"}
    full, short = (events("envgs", length, **often) for length in (30_000, steps))
    assert set(short) == set(full) - missing
    assert min(len(short["densify_base"]), len(short["densify_env"])) >= 2
    last = max(step for happened in short.values() for step in happened)
    assert last <= 0.7 * steps  # and the last third is left to converge


@pytest.mark.parametrize(
    ("steps", "usual", "settling"),
    [(30_000, 300, 1500), (12_000, 120, 600), (7000, 70, 350), (3000, 30, 150), (2000, 30, 90), (800, 30, 30)],
)
def test_the_settling_interval_leaves_the_base_ten_densifications(steps, usual, settling):
    grows = events("envgs", steps, opacity_reset_every=0, densify_until=21_000, growth="gradient")["densify_base"]
    first, last = round(0.1 * steps), round(0.6 * steps)  # 3,000 to 18,000 of 30,000
    settles = [step for step in grows if first < step <= last]
    assert settles == [step for step in range(settling, last + 1, settling) if step > first]
    assert all(step % usual == 0 for step in grows if step > last)


def test_guided_growth_does_not_wait_for_reflections_to_settle():
    assert events("envgs", 9000)["densify_base"] == list(range(180, 7_500, 90))


@pytest.mark.parametrize("steps", [3000, 4500, 10_000, 30_000, 60_000])
def test_a_longer_run_grows_no_more_often(steps):
    """The sets of EnvGS grow as often in every run that is long enough, and so converge for longer in between."""
    found = events("envgs", steps, opacity_reset_every=0, env_opacity_reset_every=0)
    assert (len(found["densify_base"]), len(found["densify_env"])) == (82, 11)


def test_an_interval_below_the_usual_one_is_refused():
    with pytest.raises(ValueError, match="settling_interval is 0, expected greater than or equal to 1"):
        create_method("envgs", {"rules": {"settling_interval": 0}})


def test_what_is_switched_off_never_happens():
    found = events(
        "envgs",
        3000,
        sabotage=False,
        propagate=False,
        opacity_reset_every=0,
        env_opacity_reset_every=0,
    )
    assert set(found) == {"densify_base", "densify_env"}


def test_positions_decay_log_linearly():
    schedule = Schedule(1000)
    assert schedule.rate(0, 1.6e-4, 1.6e-6) == pytest.approx(1.6e-4)
    assert schedule.rate(500, 1.6e-4, 1.6e-6) == pytest.approx(1.6e-5)
    assert schedule.rate(1000, 1.6e-4, 1.6e-6) == pytest.approx(1.6e-6)


def test_rotation_rates_of_reflective_methods_decay_to_three_tenths():
    """Three tenths of the rotation rate remain at the end; 2DGS keeps its own."""
    rates = {}
    for kind in ("2dgs", "envgs"):
        method = create_method(kind)
        method.initialize(SCENE, 30_000)
        method.model.set_learning_rates(30_000)
        groups = method.model.sets["base"].parameters.optimizer.param_groups
        rates[kind] = next(group["lr"] for group in groups if group["name"] == "quaternions")
    assert rates == {"2dgs": pytest.approx(1e-3), "envgs": pytest.approx(3e-4)}


@pytest.mark.parametrize(("steps", "scale"), [(60_000, 1), (30_000, 1), (7500, 2), (300, 10), (10, 10)])
def test_shorter_runs_learn_faster(steps, scale):
    assert Schedule(steps).rate_scale == pytest.approx(scale)


def test_a_run_without_steps_is_refused():
    with pytest.raises(ValueError, match="0 steps"):
        Schedule(0)


def check_recovery(steps: int) -> set[str]:
    """Walk through what a run of this length does around its resets; returns the names of all that happens then."""
    method = create_method("envgs", with_rules(beta_reset_from=6000, disturb_every=1000))
    method.initialize(SCENE, steps)
    schedule = method.model.schedule
    resets = [step for step in range(1, steps + 1) if "reset_base_opacity" in due(method, step)]
    disturbed = [step for step in around(resets, steps) if "propagate" in due(method, step)]
    hold = round(schedule.interval(PROPAGATE_HOLD, HOLD_FLOOR))
    happened = set()
    for reset in resets:
        happened |= due(method, reset)
        assert not {"propagate", "sabotage"} & due(method, reset)
        assert not any(step < reset <= step + hold for step in disturbed), f"opacities rest when {reset} resets them"
        for step in range(reset + 1, min(reset + RECOVERY, steps)):
            assert "densify_base" not in due(method, step), f"{step} prunes what {reset} has just made transparent"
    return happened.union(*(due(method, step) for step in disturbed))


def around(resets: list[int], steps: int) -> list[int]:
    """Every step from a third before the first reset on: where disturbances are."""
    return list(range(max(1, resets[0] // 3), resets[-1] + 1)) if resets else []


@pytest.mark.parametrize("steps", [300, 799, 2000, 3000, 5900, 7000, 10_000, 11_000, 31_000])
def test_no_event_undoes_another(steps):
    check_recovery(steps)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [34_000, 40_000, 46_000, 55_000, 70_000, 100_000, *range(300, 30_000, 997)])
def test_no_event_undoes_another_at_any_length(steps):
    check_recovery(steps)


@pytest.mark.parametrize("steps", [*range(2000, 12_000, 331), 31_000, 34_000, 40_000, 46_000, 55_000, 70_000, 100_000])
def test_every_length_is_disturbed_between_its_resets(steps):
    """As often as the floors allow, at the same places of the reference run, and nowhere near a reset."""
    schedule = Schedule(steps)
    found = sorted(_disturbances(schedule, 3000, 18_000, 1000, 3000))
    every = schedule.interval(3000, 600)
    assert found
    assert len(found) <= 10
    assert all(later - earlier >= 1000 for earlier, later in pairwise(found))
    for step in found:
        share = float(step % every / every)
        assert min(abs(share - 1 / 3), abs(share - 2 / 3)) * every <= 0.5 + 1e-6
    if steps >= 30_000:
        assert len(found) == 10


def test_a_run_that_does_not_stretch_is_the_reference_run_and_more():
    happens = {"beta_reset_from": 6000, "disturb_every": 1000}
    assert events("envgs", 40_000, stretches=False, **happens) == events("envgs", 30_000, **happens)
    assert Schedule(40_000, stretches=False).rate(35_000, 1.6e-4, 1.6e-6) == pytest.approx(1.6e-6)
