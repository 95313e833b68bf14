"""Known scenes as configurations: the paper's all there, named as its tables name them, with known facts."""

from __future__ import annotations

import dataclasses
import os
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch
from fakes.runs import set_environment, without_processes
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, OmegaConf

import envgs_bench
from envgs_bench.cli import choices
from envgs_bench.cli.composition import config_names, register_choices
from envgs_bench.cli.main import main
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.methods.recipes import rules_of
from envgs_bench.methods.registry import create_method
from envgs_bench.records import find_records, read_record
from envgs_bench.reports.numbers.published import paper_scene, paper_tables
from envgs_bench.settings import parse_settings

FAMILIES = ("ref_real", "ref_real_8", "nerf_casting", "envgs", "shiny_blender", "mipnerf360")
PRESETS = [name for name in config_names("dataset") if name.startswith(FAMILIES)]
CAPTURES = [name for name in config_names("dataset") if name.startswith("captures/")]
SYNTHETIC = [name for name in config_names("dataset") if name.startswith("nerf_synthetic/")]
RENDERED = [name for name in config_names("dataset") if name.startswith("rendered/")]


def composed(*overrides: str, data_root: Path | None = None) -> dict[str, Any]:
    config = _composed(*overrides)
    if data_root:
        config = config.copy()
        config.data_root = str(data_root)
    content = OmegaConf.to_container(config, resolve=True)
    assert isinstance(content, dict)
    return {str(key): value for key, value in content.items()}


@cache  # composing takes a while, and what a key is made of is looked up later
def _composed(*overrides: str) -> DictConfig:
    register_choices()
    with initialize_config_dir(str(Path(envgs_bench.__file__).parent / "conf"), version_base="1.3"):
        return compose("config", list(overrides))


def test_every_scene_of_the_papers_tables_has_a_preset_of_its_name() -> None:
    tables = paper_tables()
    rows = tables[tables["scene"] != "mean"]
    expected = set(zip(rows["dataset"], rows["scene"], strict=True))
    expected -= {("Ref-Real ÷8", "spheres"), ("Ref-Real ÷8", "toycar")}  # which are those of the other size
    assert len(expected) == len(PRESETS) == 25
    assert {paper_scene(composed(f"dataset={name}")["dataset"]["name"]) for name in PRESETS} == expected


@pytest.mark.parametrize("name", PRESETS + CAPTURES + SYNTHETIC + RENDERED)
def test_a_preset_lies_below_data_root_and_is_refused_only_because_nothing_is_there(name: str, tmp_path: Path) -> None:
    content = composed(f"dataset={name}", data_root=tmp_path)
    assert content["dataset"]["name"] == name
    assert Path(content["dataset"]["root"]).parent == tmp_path / name.split("/")[0].removesuffix("_8")
    with pytest.raises(DatasetError) as caught:
        load_scene(content["dataset"], tmp_path)
    source = "not published" if name in RENDERED else "http"
    for part in (content["dataset"]["root"], source, "this folder holds", "data_root=", "$ENVGS_BENCH_DATA_ROOT"):
        assert part in str(caught.value)
    Path(content["dataset"]["root"]).mkdir(parents=True)  # empty: the source itself reads its settings, and complains
    with pytest.raises(DatasetError) as caught:
        load_scene(content["dataset"], tmp_path)
    assert "there is no such key" not in str(caught.value)
    assert source not in str(caught.value)


@pytest.mark.skipif("ENVGS_BENCH_DATA" not in os.environ, reason="ENVGS_BENCH_DATA names no folder of real captures")
@pytest.mark.parametrize(
    ("name", "views", "size", "points"),
    [
        ("fox", (43, 7), (540, 960), 14_464),
        ("gold_cape", (104, 15), (909, 909), 42_798),
        ("lund_door", (10, 2), (646, 968), 13_630),
        ("marble_head", (42, 6), (1007, 992), 12_604),
        ("bananas", (13, 2), (1000, 665), 7_426),
        ("black_stele", (34, 5), (580, 1036), 8_270),
    ],
)
def test_a_known_capture_is_read_as_its_results_say(
    name: str, views: tuple[int, int], size: tuple[int, int], points: int, tmp_path: Path
) -> None:
    (tmp_path / "captures").symlink_to(os.environ["ENVGS_BENCH_DATA"])
    if not (tmp_path / "captures" / name).is_dir():
        pytest.skip(f"$ENVGS_BENCH_DATA/{name} is not there")
    scene = load_scene(composed(f"dataset=captures/{name}", data_root=tmp_path)["dataset"], tmp_path)
    assert (len(scene.train), len(scene.test)) == views
    assert {(view.camera.width, view.camera.height) for view in [*scene.train, *scene.test]} == {size}
    assert len(scene.points) == points
    assert all(("foreground" in view.masks) == (name in ("gold_cape", "black_stele")) for view in scene.test)


@pytest.mark.skipif("ENVGS_BENCH_DATA" not in os.environ, reason="ENVGS_BENCH_DATA names no folder of real captures")
@pytest.mark.parametrize("name", RENDERED)
def test_a_rendered_scene_scores_test_views_against_normals_that_training_views_only_guess(
    name: str, tmp_path: Path
) -> None:
    (tmp_path / "rendered").symlink_to(os.environ["ENVGS_BENCH_DATA"])
    if not (tmp_path / name).is_dir():
        pytest.skip(f"$ENVGS_BENCH_DATA/{Path(name).name} is not there")
    scene = load_scene(composed(f"dataset={name}", data_root=tmp_path)["dataset"], tmp_path)
    assert (len(scene.train), len(scene.test), len(scene.points)) == (49, 8, 6_600)
    assert {(view.camera.width, view.camera.height) for view in [*scene.train, *scene.test]} == {(200, 150)}
    for view in [*scene.train, *scene.test]:
        assert set(view.masks) == {"coated", "matt", "mirror", "near_field", "reflective"}
    exact = [view.normal for view in scene.test]
    lengths = [normal.norm(dim=-1)[normal.any(-1)] for normal in exact if normal is not None]
    assert len(lengths) == 8
    assert all(torch.allclose(length, torch.ones_like(length), atol=1e-5) for length in lengths)
    assert all(view.normal is not None for view in scene.train)


def test_every_data_set_composes() -> None:
    names = config_names("dataset")
    assert len(names) > len(PRESETS + CAPTURES + RENDERED)
    for name in names:
        root = () if "/" in name else ("++dataset.root=capture",)  # a kind, of which the data have to be said
        assert composed(f"dataset={name}", *root)["dataset"]["kind"]


def test_path_traced_scenes_are_made_at_their_size_whatever_the_data_root() -> None:
    for name in ("path_traced/copper_table", "path_traced/brushed_patio"):
        content = composed(f"dataset={name}")
        found = content["dataset"]
        assert (found["name"], found["kind"], found["scene"]) == (name, "toy", Path(name).name)
        assert (found["width"], found["height"], found["views"], content["steps"]) == (200, 150, 57, 3_000)


def test_the_papers_settings_reach_the_run() -> None:
    sedan, spheres = (composed(f"dataset=ref_real/{name}") for name in ("sedan", "spheres"))
    assert (sedan["steps"], spheres["steps"]) == (60_000, 40_000)
    assert sedan["dataset"]["downsample"] == 4
    ball = composed("dataset=shiny_blender/ball")
    assert ball["dataset"]["background"] == [1, 1, 1]
    assert (ball["dataset"]["bounds"], ball["dataset"]["downsample"]) == (50.0, 1)
    assert Path(spheres["dataset"]["root"]).name == "gardenspheres"
    sizes = {name: composed(f"dataset=mipnerf360/{name}")["dataset"]["downsample"] for name in ("garden", "room")}
    assert sizes == {"garden": 4, "room": 2}
    assert composed("dataset=ref_real/sedan", "steps=7")["steps"] == 7
    assert composed("dataset=toy/chrome_room")["steps"] == 3_000
    assert composed("dataset=colmap", "dataset.root=capture")["steps"] == 7_000
    assert {name: composed(f"dataset={name}")["steps"] for name in CAPTURES} == {
        "captures/bananas": 7_000,
        "captures/black_stele": 7_000,
        "captures/fox": 7_000,
        "captures/gold_cape": 7_000,
        "captures/lund_door": 7_000,
        "captures/marble_head": 7_000,
    }
    assert [composed(f"dataset={name}")["steps"] for name in RENDERED] == [3_000, 3_000]


def test_a_data_set_states_facts_and_leaves_a_methods_settings_alone() -> None:
    """Beside EnvGS, which is the default; beside 2DGS one of each family."""
    facts, families = {}, set()
    settings = {method: dataclasses.asdict(create_method(method).settings) for method in ("2dgs", "envgs")}
    for name in [*PRESETS, *CAPTURES, *RENDERED, "toy/chrome_room", "toy/diffuse_room"]:
        content = composed(f"dataset={name}")
        assert content["method"]["settings"] == settings["envgs"]
        dataset = content["dataset"]
        facts[name] = dataset.get("free_space", 0.0), dataset.get("bounds", 0.0)
        family = name.partition("/")[0]
        if family not in families:
            families.add(family)
            assert composed(f"dataset={name}", "method=2dgs")["method"]["settings"] == settings["2dgs"]
    known = {name: values for name, values in facts.items() if values != (0.0, 0.0)}
    assert known == {
        "captures/gold_cape": (2.2, 0.0),
        "ref_real/spheres": (0.0, 20.0),
        "ref_real/toycar": (0.0, 20.0),
        **{name: (0.0, 50.0) for name in PRESETS if name.startswith("shiny_blender/")},
    }


def test_data_root_is_an_override_or_an_environment_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ENVGS_BENCH_DATA_ROOT", raising=False)
    assert composed("dataset=ref_real/sedan")["dataset"]["root"] == "data/ref_real/sedan"
    monkeypatch.setenv("ENVGS_BENCH_DATA_ROOT", "/captures")
    assert composed("dataset=ref_real/sedan")["dataset"]["root"] == "/captures/ref_real/sedan"
    assert composed("dataset=ref_real/sedan", "data_root=/here")["dataset"]["root"] == "/here/ref_real/sedan"


def test_a_run_records_the_facts_and_where_to_get_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    set_environment(monkeypatch)
    overrides = ["dataset=ref_real/spheres", "method=envgs", "device=cpu", f"data_root={tmp_path}"]
    assert main(["run", *overrides, f"runs_dir={tmp_path / 'runs'}"]) == 2
    assert "ref_real.zip" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()
    monkeypatch.setattr(choices, "check_source", lambda settings: None)  # as where the data go after the check
    with without_processes():
        assert main(["run", *overrides, f"runs_dir={tmp_path / 'runs'}"]) == 1
    (path,) = find_records(tmp_path / "runs")
    record = read_record(path)
    assert record.status == "failed"
    assert record.error is not None
    assert "ref_real.zip" in record.error.message
    assert record.config["dataset"]["bounds"] == 20.0
    settings = create_method("envgs").settings
    assert record.config["method"]["settings"] == dataclasses.asdict(settings) | {
        "rules": dataclasses.asdict(rules_of(settings.recipe, settings.rules))
    }
    assert parse_settings(record.config).dataset["bounds"] == 20.0
