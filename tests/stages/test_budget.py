"""A run's budget reaches its method, or is refused; and models are cut to the frames that made-up clocks allow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from fakes.methods import MeanColor
from fakes.methods import Settings as FakeSettings
from rules import with_rules

from envgs_bench.core import Camera
from envgs_bench.methods.method import Budget, Method
from envgs_bench.methods.registry import create_method
from envgs_bench.records import Timing
from envgs_bench.settings import BudgetChoice, RunSettings, SettingsError, parse_settings
from envgs_bench.stages import execution
from envgs_bench.stages.budget import ANY, LOOKS, FrameLimit, check_budget, limited_method
from envgs_bench.stages.results import Results
from envgs_bench.stages.training import Training
from envgs_bench.testing import tiny_scene


def settings(method: str, **budget: Any) -> RunSettings:
    return parse_settings(
        {
            "method": {"name": method, "kind": method},
            "dataset": {"name": "tiny", "kind": "toy"},
            "budget": {"primitives": None, "mb": None, **budget},
            **{"protocol": "envgs", "seed": 0, "steps": 10, "device": "cpu", "timing": {"frames": 1, "seconds": 1}},
            **{"timeout_minutes": None, "runs_dir": "runs", "cache_dir": None, "force": False},
        }
    )


def test_the_method_is_limited_by_the_runs_budget() -> None:
    for budget, expected in (({"primitives": 123}, 123), ({}, 200), ({"mb": 0.02}, 131)):  # 152 bytes a surfel
        method = limited_method(settings("envgs_single_set", **budget), "cpu")
        method.initialize(tiny_scene(), 10)
        assert method.primitives()["base"] == expected


@pytest.mark.parametrize(
    ("budget", "problem"),
    [
        ({"primitives": 0}, "budget.primitives=0: Input should be greater than or equal to 1"),
        ({"primitives": -3}, "budget.primitives=-3"),
        ({"primitives": 2.5}, "budget.primitives=2.5"),
        ({"mb": 0}, "budget.mb=0: Input should be greater than 0"),
        ({"mb": float("nan")}, "budget.mb=nan"),
        ({"frame_ms": 0}, "budget.frame_ms=0: Input should be greater than 0"),
        ({"seconds": 3}, "budget.seconds=3: Extra inputs are not permitted"),
    ],
)
def test_a_budget_of_nothing_or_less_is_no_setting(budget: dict[str, Any], problem: str) -> None:
    with pytest.raises(SettingsError) as caught:
        settings("2dgs", **budget)
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    ("method", "budget", "problem"),
    [
        ("2dgs", {"primitives": 99}, "method 2dgs: budget.primitives is 99, expected at least 100"),
        (
            "envmap",
            {"mb": 1.0},
            "method envmap: budget.mb is 1, expected at least 1.195: 100 primitives besides 1.18 MB",
        ),
        ("fakes.methods:MeanColor", {"mb": 1.0}, "MeanColor keeps to no budget"),
        ("fakes.methods:MeanColor", {"frame_ms": 5.0}, "MeanColor keeps to no budget"),
        ("renders", {"mb": 1.0}, "method renders trains no model"),
    ],
)
def test_a_budget_that_the_method_cannot_stay_within_is_refused(
    method: str, budget: dict[str, Any], problem: str
) -> None:
    check_budget(settings(method))
    with pytest.raises(SettingsError) as caught:
        check_budget(settings(method, **budget))
    assert problem in str(caught.value)


GROWS = with_rules(densify_threshold=1e-9, min_coverage=0.0, min_views=0.0, primitives_per_pixel=0.0)
STEPS = 200


def count(method: Method) -> int:
    return sum(method.primitives().values())


def affine(fixed: float, each: float) -> Callable[[Method, Sequence[Camera]], float]:
    """A device that takes so many ms a picture, and so many a primitive."""
    return lambda method, cameras: fixed + each * count(method)


def timing(frame_ms: float) -> Timing:
    return Timing(frame_ms=frame_ms, frame_ms_p95=1, fps=1, prepare_ms=1, height=1, width=1, per_view=[], contract="")


def trained(choice: BudgetChoice, clock: Any, folder: Path) -> tuple[Method, FrameLimit, Training]:
    scene = tiny_scene()
    method = create_method("2dgs", GROWS, seed=1)
    method.limit(Budget(primitives=ANY))
    frames = FrameLimit(method, choice, scene, STEPS, clock)
    training = Training(method, scene, STEPS, 0, frames=frames)
    training.run(folder / "curve.csv", lambda event: None)
    return method, frames, training


@pytest.mark.parametrize(("fixed", "each"), [(0.0, 0.025), (1.5, 0.02)])
def test_training_ends_with_a_model_as_large_as_frames_allow(fixed: float, each: float, tmp_path: Path) -> None:
    clock, seen = affine(fixed, each), []

    def watched(method: Method, cameras: Sequence[Camera]) -> float:
        seen.append(count(method))
        return clock(method, cameras)

    method, frames, training = trained(BudgetChoice(frame_ms=4.0), watched, tmp_path)
    assert len(seen) == LOOKS // 2 - 1  # the last one would be too late
    room = (4.0 - fixed) / each
    assert training.peak_primitives >= seen[0] > room > seen[-1]  # it grew beyond, and was cut
    assert 0.85 * room < count(method) <= room
    assert frames.hold(lambda: timing(clock(method, []))).frame_ms <= 4.0
    found = f"{count(method)} primitives at the end; timed frames left room for {frames.most}"
    assert frames.sentence == f"budget.frame_ms=4: {found}"


def test_a_model_that_is_fast_enough_grows_as_without(tmp_path: Path) -> None:
    fast, _, _ = trained(BudgetChoice(frame_ms=4.0), affine(0.0, 0.001), tmp_path)
    without = create_method("2dgs", GROWS, seed=1)
    Training(without, tiny_scene(), STEPS, 0).run(tmp_path / "curve.csv", lambda event: None)
    assert count(fast) == count(without) > 200


def test_a_limit_of_primitives_holds_beside_it(tmp_path: Path) -> None:
    assert count(trained(BudgetChoice(frame_ms=4.0, primitives=150), affine(0.0, 0.01), tmp_path)[0]) == 150


def test_the_frames_of_the_record_are_within_it_whatever_training_saw(tmp_path: Path) -> None:
    method, frames, _ = trained(BudgetChoice(frame_ms=4.0), affine(0.0, 0.01), tmp_path)  # half as slow
    sizes: list[int] = []

    def timed() -> Timing:
        sizes.append(count(method))
        return timing(0.021 * count(method))

    assert frames.hold(timed).frame_ms <= 4.0
    assert len(sizes) > 1
    assert all(later < earlier for earlier, later in pairwise(sizes))
    assert sizes[-1] == count(method) > 0.85 * 4.0 / 0.021


def test_a_limit_that_no_model_is_fast_enough_for_fails_with_what_was_timed(tmp_path: Path) -> None:
    clock = affine(3.0, 0.001)
    method, frames, _ = trained(BudgetChoice(frame_ms=0.5), clock, tmp_path)
    told = r"budget.frame_ms is 0.5, and pictures of 100 primitives take 3.1 ms here: give it more, or smaller pictures"
    with pytest.raises(ValueError, match=told):
        frames.hold(lambda: timing(clock(method, [])))


def test_a_clock_that_stumbles_once_costs_no_more_than_half_of_a_model() -> None:
    method = limited_method(settings("2dgs", frame_ms=4.0), "cpu")
    method.initialize(tiny_scene(), STEPS)
    FrameLimit(method, BudgetChoice(frame_ms=4.0), tiny_scene(), STEPS, affine(1e9, 0.0)).look()
    assert count(method) == 100


def test_a_method_that_is_not_limited_between_steps_is_told_so(tmp_path: Path) -> None:
    class Deaf(MeanColor):
        def limit(self, budget: Budget) -> None:
            pass

        def primitives(self) -> dict[str, int]:
            return {"base": 1000, "env": 0}

    frames = FrameLimit(Deaf(FakeSettings()), BudgetChoice(frame_ms=1.0), tiny_scene(), 40, lambda *_: 1.5)
    with pytest.raises(ValueError, match=r"Deaf has 1,000 primitives after `limit` left it 633"):
        frames.look()


def test_what_was_found_is_there_again_after_an_interruption(tmp_path: Path) -> None:
    _, frames, _ = trained(BudgetChoice(frame_ms=4.0), affine(0.0, 0.01), tmp_path)
    other = create_method("2dgs", GROWS, seed=1)
    other.limit(Budget(primitives=ANY))
    other.initialize(tiny_scene(), STEPS)
    again = FrameLimit(other, BudgetChoice(frame_ms=4.0), tiny_scene(), STEPS)
    again.restore({"most": 120})
    assert again.most == count(other) == 120
    again.restore(frames.state())
    assert again.most == frames.most


def test_a_run_records_the_frames_that_decided(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    numbers = iter([3.0, 1.0])
    monkeypatch.setattr(execution, "time_frames", lambda *_: timing(next(numbers)))
    monkeypatch.setattr(execution, "load_for_run", lambda *_: tiny_scene())
    given = settings("2dgs", frame_ms=2.0).model_copy(update={"steps": 1, "cache_dir": tmp_path})
    results = Results("tiny", 1)
    execution.execute(given, tmp_path, results, lambda event: None)
    assert results.timing is not None
    assert results.timing.frame_ms == 1.0
    assert results.cost is not None
    assert results.cost.primitives["base"] == int(0.95 * 2 / 3 * 200)
    assert results.notes[-1].startswith("budget.frame_ms=2: ")
    assert next(numbers, None) is None
