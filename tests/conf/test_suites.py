"""The suites of docs/tuning.md: what is in them, and that none is tuned on what it is judged by."""

from __future__ import annotations

import pytest
from sweeps import one_run, swept

EXPERIMENTS = ("tuning", "scores")


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_a_suite_is_of_the_baselines_as_published_and_tuned(experiment: str) -> None:
    assert swept(experiment)["method"] == ["2dgs", "2dgs_tuned", "3dgs", "3dgs_tuned", "envmap", "envgs"]


def test_settings_are_chosen_on_validation_views_and_judged_on_test_views() -> None:
    tested = swept("scores", "suite=tuning")
    held_out, results = (swept("scores", f"suite={suite}")["dataset"] for suite in ("held_out", "results"))
    assert swept("tuning")["dataset"] == tested["dataset"]
    assert not set(tested["dataset"]) & set(held_out)
    assert sorted(results) == sorted([*tested["dataset"], *held_out])
    assert swept("tuning")["seed"] == ["0", "1"]
    assert tested["seed"] == ["0", "1", "2"]
    assert [one_run(name).score_on for name in EXPERIMENTS] == ["validation", "test"]


def test_a_run_of_the_suite_is_as_long_as_its_data_set_says() -> None:
    assert {one_run("tuning", dataset=name).steps for name in swept("tuning")["dataset"]} == {3_000}
    assert one_run("scores", dataset="captures/gold_cape").steps == 7_000


def test_a_room_of_other_textures_is_a_data_set_of_its_own_name() -> None:
    run = one_run("tuning", dataset="toy/chrome_room", dataset__seed="1", dataset__name="toy/chrome_room_1")
    assert (run.dataset["scene"], run.dataset["seed"], run.dataset["name"]) == ("chrome_room", 1, "toy/chrome_room_1")
    assert run.score_on == "validation"
