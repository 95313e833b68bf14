"""Prepared sweeps: every run of each can be composed, and those of the paper's tables are on its scenes."""

from __future__ import annotations

import re

import pytest
from fakes.runs import set_environment
from sweeps import one_run, swept

from envgs_bench.cli.composition import CONF, config_names
from envgs_bench.reports.numbers.published import paper_method, paper_scene, paper_tables

BUILT = {
    "3DGS",
    "2DGS",
    "GaussianShader",
    "3iGS",
    "3DGS-DR",
    "EnvGS",
}  # of the paper's methods, those that are made here
ON_THE_PAPERS_SCENES = ("table1", "table2", "table3", "table5", "table7", "table8", "table9")


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


@pytest.mark.parametrize("name", config_names("experiment"))
def test_every_choice_of_an_experiment_can_be_composed(name: str) -> None:
    """Each value once, beside any of the others: which method runs says nothing of which data set there is."""
    choices = swept(name)
    filters = choices.get("method.settings.beta_filter", [])
    for turn in range(max(map(len, (choices["method"], choices.get("dataset", []), filters)))):
        chosen = {key: values[turn % len(values)] for key, values in choices.items()}
        run = one_run(name, **{key.replace(".", "__"): value for key, value in chosen.items()})
        assert run.method.name == chosen["method"]
        if "dataset" in chosen:
            assert run.dataset["name"] == ("toy/chrome_room_800" if name == "toys800" else chosen["dataset"])
        if filters:
            assert run.method.settings["beta_filter"] == float(chosen["method.settings.beta_filter"])


@pytest.mark.parametrize("name", ON_THE_PAPERS_SCENES)
def test_an_experiment_after_a_table_is_on_the_tables_scenes(name: str) -> None:
    tables = paper_tables()
    rows = tables[tables["table"] == name.removeprefix("table")]
    families = {family for dataset in rows["dataset"] for family in dataset.split("+")}
    whole = tables[tables["dataset"].isin(families) & (tables["scene"] != "mean")]
    expected = set(zip(whole["dataset"], whole["scene"], strict=True))
    choices = swept(name)
    assert sorted(paper_scene(dataset) or () for dataset in choices["dataset"]) == sorted(expected)
    methods = choices["method"]
    assert methods[-1] == "envgs"  # ours, beside what the table has
    assert {paper_method(method) for method in methods[:-1]} == BUILT & set(rows["method"])


def test_the_commands_for_the_released_recipe_train_every_scene_once() -> None:
    """docs/paper.md has a command a variant; together they are the scenes of Tables 1, 3 and 8."""
    text = (CONF.parent / "docs" / "paper.md").read_text(encoding="utf-8").replace("\\\n", " ")
    commands = re.findall(r"^ +envgs-bench run -m method=(envgs_released\w*) +dataset=(\S+)$", text, re.MULTILINE)
    assert {f"method={name}" for name, _ in commands} == {
        f"method={name}" for name in config_names("method") if name.startswith("envgs_released_")
    }
    runs = [(method, dataset) for method, datasets in commands for dataset in datasets.split(",")]
    for method, dataset in runs:
        run = one_run("table1", method=method, dataset=dataset)
        assert (run.method.name, run.dataset["name"]) == ("envgs_released", dataset)
    scenes = {scene for table in ("table1", "table3", "table8") for scene in swept(table)["dataset"]}
    assert sorted(dataset for _, dataset in runs) == sorted(scenes)


def test_the_ablations_are_every_row_of_table_4_and_the_single_set() -> None:
    tables = paper_tables()
    methods = swept("table4")["method"]
    printed = {paper_method(name) for name in methods} - {"envgs_paper_single_set"}
    assert printed == set(tables[tables["table"] == "4"]["method"])
    assert len(printed) == len(methods) - 1


def test_the_filters_are_those_of_table_6() -> None:
    tables = paper_tables()
    shares = swept("table6")["method.settings.beta_filter"]
    printed = {paper_method(f"envgs_paper [beta_filter={share}]") for share in shares}
    tracers = {"w/ PyTorch", "w/ 1x1-tile rasterizer"}  # `envgs-bench bench tracers`
    assert printed == set(tables[tables["table"] == "6"]["method"]) - tracers
