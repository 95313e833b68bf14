"""A run's budget reaches its method, and one that the method cannot stay within is refused before anything runs."""

from __future__ import annotations

from typing import Any

import pytest

from envgs_bench.settings import RunSettings, SettingsError, parse_settings
from envgs_bench.stages.budget import check_budget, limited_method
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
        ({"frame_ms": 3}, "budget.frame_ms=3: Extra inputs are not permitted"),
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
