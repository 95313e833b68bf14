"""The sweeps over budgets: octaves, seeds enough for a knee, and a map whose budget binds nothing but the start."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest
from sweeps import one_run, swept

from envgs_bench.cli.composition import CONF
from envgs_bench.reports.numbers.comparison import FEWEST_SEEDS
from envgs_bench.stages.budget import check_budget

MAP = (
    (CONF.parent / "docs" / "reference" / "budgets.md").read_text(encoding="utf-8").split("experiment=budget_curve")[2]
)


def of_the_map(key: str) -> list[int]:
    """What the page's command for a map takes in turn."""
    found = re.search(rf"{key}=([\d,]+)", MAP)
    assert found is not None
    return [int(size) for size in found[1].split(",")]


@pytest.mark.parametrize(
    "sizes",
    [
        [int(size) for size in swept("budget_curve")["budget.primitives"]],
        of_the_map("settings.max_primitives"),
        of_the_map("env_max_primitives"),
    ],
)
def test_sizes_are_in_octaves(sizes: list[int]) -> None:
    assert {round(larger / smaller, 1) for smaller, larger in pairwise(sizes)} == {2.0}


def test_every_seed_is_reached_in_turn_and_there_are_enough_for_a_knee() -> None:
    choices = swept("budget_curve")
    assert next(iter(choices)) == "seed"
    assert len(choices["seed"]) >= FEWEST_SEEDS
    smallest = min(map(int, choices["budget.primitives"]))
    for method in choices["method"]:
        run = one_run("budget_curve", method=method, budget__primitives=str(smallest))
        assert run.budget is not None
        assert run.budget.primitives == smallest
        check_budget(run)


def test_the_maps_budget_is_above_all_of_its_bounds() -> None:
    most = of_the_map("settings.max_primitives")[-1] + of_the_map("env_max_primitives")[-1]
    assert of_the_map("budget.primitives")[0] > 2 * most
    assert of_the_map("primitives_per_pixel") == [0]
