"""`envgs-bench diagnose`: counts with a known answer, and what it asks of a scene."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest
from scipy.stats import binom
from toy_scenes import rough_toys

import envgs_bench
from envgs_bench.cli import diagnosis_counts
from envgs_bench.cli.diagnosis_counts import SPOILED, counted
from envgs_bench.cli.main import main
from envgs_bench.core import Scene
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS
from envgs_bench.diagnosis.repair import REPAIRS
from envgs_bench.diagnosis.scene_warnings import scene_warnings
from envgs_bench.diagnosis.thresholds import (
    BLOCKY,
    BLURRED,
    DISAGREEING,
    MIRROR_GAIN,
    MISSING,
    NOISY,
    POSES_OFF,
    TELLING,
    UNSUPPORTED,
)
from envgs_bench.reports.kept.counts import ANSWERS, OF_SCENES, CountsError, rates, read_counts


def rows_of(*scenes: tuple[str, str, str], severity: int = 2) -> pd.DataFrame:
    """A row a scene: what is spoiled, the warnings, the repairs."""
    return pd.DataFrame(
        [
            {
                "seed": seed,
                "spoiled": spoiled,
                "severity": severity * bool(spoiled),
                "warned": warned,
                "repaired": right,
            }
            for seed, (spoiled, warned, right) in enumerate(scenes)
        ]
    )


def test_rates_are_shares_with_what_they_leave_possible() -> None:
    """The bounds are those of the binomial distribution: at them, the count or one further out has a chance of 5 %."""
    in_order = [("", "views_sparse poses_off" if seed < 2 else "", "") for seed in range(40)]
    spoiled = [("exposure", "poses_off", "exposures" if seed < 37 else "normals") for seed in range(40)]
    table = {(rate.spoiled, rate.asked): rate for rate in rates(rows_of(*in_order, *spoiled))}
    false = table["", "warning poses_off"]
    assert (false.found, false.scenes) == (2, 40)
    assert binom.cdf(2, 40, false.bound) == pytest.approx(0.05)
    assert table["", "any warning"].found == 2
    assert table["", "repair exposures"].bound == pytest.approx(1 - 0.05 ** (1 / 40))
    found = table["exposure", "repair exposures"]
    assert found.found == 37
    assert binom.sf(36, 40, found.bound) == pytest.approx(0.05)
    assert table["exposure", "warning exposures_differ"].found == 0


def test_what_is_spoiled_is_a_perturbation_that_a_warning_and_a_repair_are_for() -> None:
    assert {kind for kind, _ in SPOILED} == set(ANSWERS)
    for kind, severity in SPOILED:
        assert severity <= len(PERTURBATIONS[kind].levels)
        asked = {tuple(question.split()) for question in ANSWERS[kind]}
        assert asked <= {("warning", each) for each in OF_SCENES} | {("repair", each) for each in REPAIRS}


def test_every_warning_of_a_scene_is_asked() -> None:
    """Those that `scene_warnings` names, but for what is of a run's length and near plane."""
    names = re.findall(r'^            "(\w+)",$', inspect.getsource(scene_warnings), re.MULTILINE)
    assert sorted(names) == sorted({*OF_SCENES, "run_short", "near_hides"})


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    with rough_toys():
        settings = {"kind": "toy", "scene": "chrome_room", "width": 16, "height": 16, "views": 10, "supersampling": 1}
        return load_scene(settings, tmp_path_factory.mktemp("cache"))


def test_mirrored_normals_count_as_repaired_where_just_those_views_are_named(
    room: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A diagnosis that names all views is right where all of them are mirrored, and wrong where a quarter is."""
    every = SimpleNamespace(mirrored=SimpleNamespace(views=[view.name for view in room.train]))
    monkeypatch.setattr(diagnosis_counts, "Diagnosis", lambda *_: every)
    monkeypatch.setattr(diagnosis_counts, "MEASURED", dict.fromkeys(diagnosis_counts.MEASURED, lambda _: 0.12345))
    monkeypatch.setattr(diagnosis_counts, "scene_warnings", lambda *_: [SimpleNamespace(kind="poses_off")])
    kept = [SimpleNamespace(kind="normals", kept=True), SimpleNamespace(kind="exposures", kept=False)]
    monkeypatch.setattr(diagnosis_counts, "repaired", lambda given, kinds: (given, kept))
    first, *spoiled = counted(room, 0)
    assert (first["spoiled"], first["width"], first["views"]) == ("", 16, len(room.train))
    assert first["repaired"] == "normals"  # a false alarm
    assert [row["repaired"] for row in spoiled if row["spoiled"] == "normals_mirrored"] == ["", "", "normals"]
    assert {row["warned"] for row in spoiled} == {"poses_off"}
    measured = [row.get("stops") for row in (first, *spoiled)]
    assert measured == [pytest.approx(0.1235)] * 3 + [None] * 4


def test_what_was_counted_is_counted_by_these_thresholds() -> None:
    """Of scenes in order each warning is given where its threshold says so, but for what rounding may turn over."""
    rows = read_counts(Path(envgs_bench.__file__).parent / "docs" / "records" / "warnings.csv")
    rows = rows[rows["spoiled"] == ""].set_index("seed")
    measured = rows[list(diagnosis_counts.MEASURED)].apply(pd.to_numeric)  # NaN: not asked
    told = (measured["photo_consistency"] >= UNSUPPORTED) & (measured["coverage"] >= TELLING)
    limits = {
        "views_noisy": measured["noise"] - NOISY,
        "views_blurred": BLURRED - measured["detail"],
        "views_blocky": measured["blockiness"] - BLOCKY,
        "points_missing": MISSING - measured["coverage"],
        "points_unsupported": UNSUPPORTED - measured["photo_consistency"],
        "poses_off": (measured["pose_gain"] - POSES_OFF).where(told, -1),
        "normals_mirrored": (measured["mirror_gain"] - MIRROR_GAIN).fillna(-1),
        "normals_disagree": (measured["normal_disagreement"] - DISAGREEING) / 90,
    }
    assert len(rows) > 100
    for kind, beyond in limits.items():
        warned = rows["warned"].map(lambda words, kind=kind: kind in words.split())
        assert (warned == (beyond > 0))[beyond.abs() > 0.001].all(), kind


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
        size = {"width": 64, "height": 48, "views": 28}
        said = {"warned": "poses_off" if seed == 6 else "", "repaired": ""}
        return [{"seed": seed, **size, "spoiled": "", "severity": 0, **said}]

    monkeypatch.setattr(diagnosis_counts, "counted", count)
    monkeypatch.setattr("envgs_bench.datasets.load_scene", lambda settings, cache: settings["seed"])
    for last in (5, 7):
        assert main(["diagnose", "--seeds", f"4-{last}", "--out", str(tmp_path / "counts.csv")]) == 0
    assert asked == [4, 5, 6, 7]
    assert "any warning" in capsys.readouterr().out
    assert read_counts(tmp_path / "counts.csv")["warned"].tolist() == ["", "", "poses_off", ""]


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "other.csv").write_text("seed,found\n1,2\n", encoding="utf-8")
    with pytest.raises(CountsError, match="it has no width"):
        read_counts(tmp_path / "other.csv")
