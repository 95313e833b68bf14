"""The suites of docs/tuning.md: every run of them composes, and none is tuned on what it is judged by."""

from __future__ import annotations

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig

from envgs_bench.cli.composition import CONF, register_methods, settings_of
from envgs_bench.settings import RunSettings

SUITES = ("tuning", "tuning_test", "untouched")


def config(*overrides: str, with_hydra: bool = False) -> DictConfig:
    register_methods()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose("config", list(overrides), return_hydra_config=with_hydra)


def swept(suite: str) -> dict[str, list[str]]:
    """What `envgs-bench run -m experiment=<name>` takes in turn, by key."""
    parser = OverridesParser.create()
    parameters = config(f"experiment={suite}", with_hydra=True).hydra.sweeper.params
    overrides = {key: parser.parse_override(f"{key}={values}") for key, values in parameters.items()}
    return {key: list(override.sweep_string_iterator()) for key, override in overrides.items()}


def one_run(suite: str, **choices: str) -> RunSettings:
    overrides = [f"experiment={suite}", *(f"{key.replace('__', '.')}={value}" for key, value in choices.items())]
    return settings_of(config(*overrides), overrides)


@pytest.mark.parametrize("suite", SUITES)
def test_every_scene_and_method_of_a_suite_composes(suite: str) -> None:
    choices = swept(suite)
    assert choices["method"] == ["2dgs", "3dgs", "envmap", "envgs"]
    assert [one_run(suite, dataset=name).dataset["name"] for name in choices["dataset"]] == choices["dataset"]
    assert [one_run(suite, method=name).method.name for name in choices["method"]] == choices["method"]


def test_settings_are_chosen_on_validation_views_and_judged_on_test_views() -> None:
    tuning, tested, untouched = (swept(suite) for suite in SUITES)
    assert tuning["dataset"] == tested["dataset"]
    assert not set(tuning["dataset"]) & set(untouched["dataset"])
    assert tuning["seed"] == ["0", "1"]
    assert tested["seed"] == untouched["seed"] == ["0", "1", "2"]
    assert [one_run(suite).score_on for suite in SUITES] == ["validation", "test", "test"]


def test_a_run_of_the_suite_is_as_long_as_its_data_set_says() -> None:
    assert {one_run("tuning", dataset=name).steps for name in swept("tuning")["dataset"]} == {3_000}
    assert one_run("untouched", dataset="captures/gold_cape").steps == 7_000


def test_a_room_of_other_textures_is_a_data_set_of_its_own_name() -> None:
    run = one_run("tuning", dataset="toy/chrome_room", dataset__seed="1", dataset__name="toy/chrome_room_1")
    assert (run.dataset["scene"], run.dataset["seed"], run.dataset["name"]) == ("chrome_room", 1, "toy/chrome_room_1")
    assert run.score_on == "validation"
