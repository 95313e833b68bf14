"""The sweeps over budgets: octaves, seeds enough for a knee, and a map whose budget binds nothing but the start."""

from __future__ import annotations

from itertools import pairwise

import pytest
from sweeps import one_run, swept

from envgs_bench.reports.numbers.comparison import FEWEST_SEEDS
from envgs_bench.stages.budget import check_budget


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("budget_curve", "budget.primitives"),
        ("budget_map", "method.settings.max_primitives"),
        ("budget_map", "method.settings.env_max_primitives"),
    ],
)
def test_sizes_are_in_octaves(name: str, key: str) -> None:
    sizes = [int(size) for size in swept(name)[key]]
    assert {round(larger / smaller, 1) for smaller, larger in pairwise(sizes)} == {2.0}


@pytest.mark.parametrize("name", ["budget_curve", "budget_map"])
def test_every_seed_is_reached_in_turn_and_there_are_enough_for_a_knee(name: str) -> None:
    choices = swept(name)
    assert next(iter(choices)) == "seed"
    assert len(choices["seed"]) >= FEWEST_SEEDS
    smallest = min(map(int, choices["budget.primitives"]))
    for method in choices["method"]:
        run = one_run(name, method=method, budget__primitives=str(smallest))
        assert run.budget is not None
        assert run.budget.primitives == smallest
        check_budget(run)


def test_the_maps_budget_is_above_all_of_its_bounds() -> None:
    choices = swept("budget_map")
    most = sum(int(choices[f"method.settings.{name}"][-1]) for name in ("max_primitives", "env_max_primitives"))
    assert int(choices["budget.primitives"][0]) > 2 * most
    run = one_run(
        "budget_map", method__settings__pixels_per_primitive=choices["method.settings.pixels_per_primitive"][0]
    )
    assert run.method.settings["pixels_per_primitive"] == 0
