"""Prepared sweeps: every run of each can be composed, and those of the paper's tables are on its scenes."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from fakes.runs import set_environment
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser

from envgs_bench.cli import composition
from envgs_bench.cli.composition import config_names, register_methods, settings_of
from envgs_bench.reports.numbers.published import paper_method, paper_scene, paper_tables
from envgs_bench.settings import RunSettings

ON_THE_PAPERS_SCENES = ("table1", "table2", "table3", "table5", "table7", "table8", "table9")


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)
    register_methods()


def swept(experiment: str) -> dict[str, list[str]]:
    """What the experiment sweeps over, as overrides, by their key."""
    with initialize_config_dir(str(composition.CONF), version_base="1.3"):
        config = compose("config", [f"experiment={experiment}"], return_hydra_config=True)
    lines = [f"{key}={value}" for key, value in config.hydra.sweeper.params.items()]
    parsed = OverridesParser.create().parse_overrides(lines)
    return {
        str(override.key_or_group): [f"{override.key_or_group}={choice}" for choice in override.sweep_string_iterator()]
        if override.is_sweep_override()
        else [line]
        for override, line in zip(parsed, lines, strict=True)
    }


def settings(experiment: str, overrides: Sequence[str]) -> RunSettings:
    with initialize_config_dir(str(composition.CONF), version_base="1.3"):
        return settings_of(compose("config", [f"experiment={experiment}", *overrides]), [])


@pytest.mark.parametrize("name", config_names("experiment"))
def test_every_choice_of_an_experiment_can_be_composed(name: str) -> None:
    """Each value with the others' first: which method runs says nothing of which data set there is."""
    choices = swept(name)
    assert choices
    first = {key: values[0] for key, values in choices.items()}
    for key, values in choices.items():
        for value in values:
            made = settings(name, list((first | {key: value}).values()))
            if key == "method":
                assert made.method.name == value.removeprefix("method=")
            if key == "dataset" and value.startswith("dataset=") and name != "toys800":  # it names its own
                assert made.dataset["name"] == value.removeprefix("dataset=")


@pytest.mark.parametrize("name", ON_THE_PAPERS_SCENES)
def test_an_experiment_after_a_table_is_on_the_tables_scenes(name: str) -> None:
    tables = paper_tables()
    rows = tables[tables["table"] == name.removeprefix("table")]
    families = {family for dataset in rows["dataset"] for family in dataset.split("+")}
    whole = tables[tables["dataset"].isin(families) & (tables["scene"] != "mean")]
    expected = set(zip(whole["dataset"], whole["scene"], strict=True))
    choices = swept(name)
    assert sorted(paper_scene(value.removeprefix("dataset=")) or () for value in choices["dataset"]) == sorted(expected)
    methods = [value.removeprefix("method=") for value in choices["method"]]
    assert methods[-1] == "envgs"  # ours, beside what the table has
    assert {paper_method(method) for method in methods[:-1]} == {"3DGS", "2DGS", "EnvGS"} & set(rows["method"])


def test_the_ablations_are_every_row_of_table_4_and_the_single_set() -> None:
    tables = paper_tables()
    methods = [value.removeprefix("method=") for value in swept("table4")["method"]]
    printed = {paper_method(name) for name in methods} - {"envgs_paper_single_set"}
    assert printed == set(tables[tables["table"] == "4"]["method"])
    assert len(printed) == len(methods) - 1


def test_the_filters_are_those_of_table_6() -> None:
    tables = paper_tables()
    shares = [value.partition("=")[2] for value in swept("table6")["method.settings.beta_filter"]]
    printed = {paper_method(f"envgs_paper [beta_filter={share}]") for share in shares}
    tracers = {"w/ PyTorch", "w/ 1x1-tile rasterizer"}  # `envgs-bench bench tracers`
    assert printed == set(tables[tables["table"] == "6"]["method"]) - tracers
