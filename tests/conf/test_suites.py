"""The suites of docs/explanation/settings.md: what is in them, and that none is tuned on what it is judged by."""

from __future__ import annotations

from sweeps import one_run, swept

EXPERIMENTS = ("tuning", "scores")


def test_a_suite_is_of_the_baselines_as_published_and_tuned() -> None:
    baselines = ["2dgs", "2dgs_tuned", "3dgs", "3dgs_tuned", "envmap"]
    assert swept("tuning")["method"] == [*baselines, "envgs"]
    assert swept("scores")["method"] == [*baselines, "envgs_released", "envgs"]


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
    steps = {name: one_run("tuning", dataset=name).steps for name in swept("tuning")["dataset"]}
    assert steps == {name: 7_000 if name.startswith("captures/") else 3_000 for name in steps}
    assert one_run("scores", dataset="captures/gold_cape").steps == 7_000


def test_the_suites_at_real_size_are_photographs_as_they_are_and_rendered_scenes_of_their_size() -> None:
    photographs = [one_run("photographs", dataset=name) for name in swept("photographs")["dataset"]]
    assert {run.steps for run in photographs} == {7_000}
    assert {run.dataset.get("downsample", 1) for run in photographs if run.dataset["kind"] == "colmap"} == {1}
    large = swept("photographs", "suite=large", "size=large")["dataset"]
    rendered = [one_run("photographs", suite="large", size="large", dataset=name) for name in large]
    assert {(run.dataset["width"], run.dataset["height"], run.steps) for run in rendered} == {(800, 600, 7_000)}
    assert len({run.dataset["name"] for run in rendered}) == len(large)


def test_a_room_of_other_textures_is_a_data_set_of_its_own_name() -> None:
    run = one_run("tuning", dataset="toy/chrome_room", dataset__seed="1", dataset__name="toy/chrome_room_1")
    assert (run.dataset["scene"], run.dataset["seed"], run.dataset["name"]) == ("chrome_room", 1, "toy/chrome_room_1")
    assert run.score_on == "validation"
