"""Prepared sweeps: every run of each can be composed, and those of the paper's tables are on its scenes."""

from __future__ import annotations

from functools import cache

import pytest
from fakes.runs import set_environment
from sweeps import one_run, swept

from envgs_bench.cli.composition import composed, config_names
from envgs_bench.reports.numbers.published import paper_method, paper_scene, paper_tables
from envgs_bench.runs.descriptions import card_of

BUILT = {
    "3DGS",
    "2DGS",
    "GaussianShader",
    "3iGS",
    "3DGS-DR",
    "EnvGS",
}  # of the paper's methods, those that are made here
ON_THE_PAPERS_SCENES = ("table1", "table3", "table8", "table9")
SCORED = ("scores", "photographs", "population", "rivals", *ON_THE_PAPERS_SCENES)
WITH_TABLE_1 = ("2", "5", "7")  # tables of the runs of Table 1


@cache
def printed_name(method: str, swept: str = "") -> str:
    """The paper's name of a row of that method, or the row's own."""
    kind = composed([f"method={method}"]).method.kind
    card = card_of(method, kind)
    assert card is not None
    return paper_method(method + swept, card, kind)


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
            assert run.dataset["name"] == chosen["dataset"]
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
    assert methods[-2:] == ["envgs_released", "envgs"]  # the authors' code and ours, beside what the table has
    assert {printed_name(method) for method in methods[:-2]} == BUILT & set(rows["method"])


@pytest.mark.parametrize("name", SCORED)
def test_the_authors_code_stands_beside_envgs_wherever_methods_are_ranked(name: str) -> None:
    assert {"envgs_released", "envgs"} <= set(swept(name)["method"])


@pytest.mark.parametrize("table", WITH_TABLE_1)
def test_the_runs_of_table_1_are_those_of_others(table: str) -> None:
    rows = paper_tables()
    ours, printed = swept("table1"), rows[rows["table"] == table]
    assert BUILT & set(printed["method"]) <= {printed_name(method) for method in ours["method"]}
    scenes = {(row.dataset, row.scene) for row in printed.itertuples() if row.scene != "mean"}
    assert scenes <= {paper_scene(dataset) for dataset in ours["dataset"]}


def test_a_scene_at_the_papers_size_is_a_data_set_of_its_own_name() -> None:
    run = one_run("scores", dataset="toy/glass", size="paper")
    assert (run.dataset["name"], run.dataset["width"], run.steps) == ("toy/glass_800", 800, 30_000)


def test_the_ablations_are_every_row_of_table_4_and_the_single_set() -> None:
    tables = paper_tables()
    methods = swept("table4")["method"]
    printed = {printed_name(name) for name in methods} - {"envgs_paper_single_set"}
    assert printed == set(tables[tables["table"] == "4"]["method"])
    assert len(printed) == len(methods) - 1


def test_the_filters_are_those_of_table_6() -> None:
    tables = paper_tables()
    shares = swept("table6")["method.settings.beta_filter"]
    printed = {printed_name("envgs_paper", f" [beta_filter={share}]") for share in shares}
    tracers = {"w/ PyTorch", "w/ 1x1-tile rasterizer"}  # `envgs-bench bench tracers`
    assert printed == set(tables[tables["table"] == "6"]["method"]) - tracers
