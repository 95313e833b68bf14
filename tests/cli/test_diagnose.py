"""`envgs-bench diagnose`: counts with a known answer, and what it asks of a scene."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest
from scipy.stats import binomtest
from toy_scenes import rough_toys

from envgs_bench.cli import diagnosis_counts
from envgs_bench.cli.diagnosis_counts import OF_SCENES, SPOILED, counted, rates
from envgs_bench.cli.main import main
from envgs_bench.core import Scene
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS
from envgs_bench.diagnosis.repair import REPAIRS
from envgs_bench.diagnosis.scene_warnings import scene_warnings


def test_rates_are_shares_with_their_intervals() -> None:
    asked = [("", "any warning", seed < 2) for seed in range(40)]
    asked += [("exposure", "repair exposures", seed < 37) for seed in range(40)]
    rows = [
        {"spoiled": kind, "severity": int(bool(kind)), "asked": what, "found": found} for kind, what, found in asked
    ]
    table = rates(rows).set_index("asked")
    assert table.loc["any warning", ["found", "scenes", "share"]].tolist() == [2, 40, 0.05]
    interval = binomtest(37, 40).proportion_ci(0.95)
    assert table.loc["repair exposures", ["low", "high"]].tolist() == pytest.approx([interval.low, interval.high])


def test_what_is_spoiled_is_a_perturbation_that_a_repair_is_for() -> None:
    for kind, severity, repair, _ in SPOILED:
        assert severity <= len(PERTURBATIONS[kind].levels)
        assert repair is None or repair in REPAIRS


def test_every_warning_of_a_scene_is_asked() -> None:
    """Those that `scene_warnings` names, but for what is of a run's length and near plane."""
    names = re.findall(r'^            "(\w+)",$', inspect.getsource(scene_warnings), re.MULTILINE)
    assert sorted(names) == sorted({*OF_SCENES, "run_short", "near_hides"})


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    with rough_toys():
        settings = {"kind": "toy", "scene": "chrome_room", "width": 16, "height": 12, "views": 10, "supersampling": 1}
        return load_scene(settings, tmp_path_factory.mktemp("cache"))


def test_mirrored_normals_count_as_found_where_just_those_views_are_named(
    room: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A diagnosis that names all views is wrong where half of them are mirrored."""

    def diagnosis(scene: Scene, device: str) -> Any:
        changed = [a.name for a, b in zip(scene.train, room.train, strict=True) if a is not b]
        return SimpleNamespace(mirrored=[view.name for view in scene.train] if every else changed)

    monkeypatch.setattr(diagnosis_counts, "Diagnosis", diagnosis)
    monkeypatch.setattr(diagnosis_counts, "_measured", lambda _: {})
    monkeypatch.setattr(diagnosis_counts, "scene_warnings", lambda *_: [SimpleNamespace(kind="poses_off")])
    named = [SimpleNamespace(kind="normals", kept=True, message="")]
    monkeypatch.setattr(diagnosis_counts, "repaired", lambda given, kinds: (given, named if "normals" in kinds else []))
    for every in (False, True):
        table = pd.DataFrame(counted(room, 0)).set_index(["spoiled", "asked"])["found"]
        assert table["normals_mirrored", "repair normals"] == (not every)
        assert table["pose_rotation", "warning poses_off"]
        assert table["", "warning poses_off"]  # a false alarm
        assert not table["exposure", "warning exposures_differ"]


def test_seeds_that_are_none_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for seeds in ("9-3", "a", "-4"):
        assert main(["diagnose", f"--seeds={seeds}", "--out", str(tmp_path / "counts.csv")]) == 2
        assert "expected FIRST-LAST" in capsys.readouterr().err


def test_scenes_that_were_asked_are_not_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[int] = []

    def count(scene: int, seed: int) -> list[dict[str, Any]]:
        asked.append(seed)
        return [{"seed": seed, "spoiled": "", "severity": 0, "asked": "any warning", "found": seed == 6}]

    monkeypatch.setattr(diagnosis_counts, "counted", count)
    monkeypatch.setattr("envgs_bench.datasets.load_scene", lambda settings, cache: settings["seed"])
    for last in (5, 7):
        assert main(["diagnose", "--seeds", f"4-{last}", "--out", str(tmp_path / "counts.csv")]) == 0
    assert asked == [4, 5, 6, 7]
    assert "any warning" in capsys.readouterr().out
    assert pd.read_csv(tmp_path / "counts.csv")["found"].sum() == 1
