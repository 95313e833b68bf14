"""What layouts lose, of runs whose folders were made by hand: settings and a checkpoint of a few steps."""

from __future__ import annotations

import csv
import json
import shutil
import sys
from pathlib import Path

import pytest
import torch
import yaml
from fakes.runs import set_environment
from reports_runs import record

from envgs_bench.cli.main import main
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.storage import compact
from envgs_bench.records import Cost
from envgs_bench.run_folder import CHECKPOINT
from envgs_bench.stages.cost import with_files
from envgs_bench.stored.layout_losses import layout_losses, require_layouts
from envgs_bench.stored.reopening import reopen
from envgs_bench.testing import tiny_scene

SETTINGS = {
    **{"dataset": {"name": "tiny", "kind": "fakes.datasets:tiny"}, "protocol": "strict", "seed": 3, "steps": 12},
    **{"device": "cpu", "timing": {"frames": 1, "seconds": 0.01}, "timeout_minutes": None, "runs_dir": "runs"},
    **{"cache_dir": "cache", "force": False},
}
KINDS = {"envgs": {"env_grid": 3}, "2dgs": {}}


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs' folders."""
    folder = tmp_path_factory.mktemp("runs")
    for kind, own in KINDS.items():
        (folder / kind).mkdir()
        content = SETTINGS | {"method": {"name": f"our_{kind}", "kind": kind, "settings": own}}
        (folder / kind / "config.yaml").write_text(yaml.safe_dump(content))
        (folder / kind / "record.json").write_text(json.dumps(record("tiny", kind, 3)))
        method, scene = create_method(kind, own), tiny_scene()
        method.initialize(scene, 12)
        for step in range(1, 13):
            method.training_step(scene.train[step % len(scene.train)], step)
        method.save(folder / kind / CHECKPOINT)
    return folder


def test_a_row_a_run_and_layout(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {path: path.stat().st_mtime_ns for path in runs.rglob("*")}
    command = ["layouts", str(runs), "--layout", "ply-two-scales", "--layout", "compact", "--device", "cpu", "--out"]
    assert main([*command, str(tmp_path)]) == 0
    assert {path: path.stat().st_mtime_ns for path in runs.rglob("*")} == before
    rows = list(csv.DictReader((tmp_path / "layouts.csv").open()))
    assert [(row["method"], row["layout"]) for row in rows] == [
        (f"our_{kind}", layout) for kind in ("2dgs", "envgs") for layout in ("ply-two-scales", "compact")
    ]
    for plain, small in (rows[:2], rows[2:]):
        assert (plain["dataset"], plain["seed"], plain["lacks"]) == ("tiny", "3", "")
        assert [float(plain[name]) for name in ("times_smaller", "psnr_change", "ssim_change")] == [1, 0, 0]
        assert float(small["times_smaller"]) == pytest.approx(int(plain["file_bytes"]) / int(small["file_bytes"]))
        assert float(small["times_smaller"]) > 5
        changed = float(small["psnr"]) - float(plain["psnr"])
        assert 0 < abs(changed) < 0.1
        assert float(small["psnr_change"]) == pytest.approx(changed)
        assert small["lpips"] == small["lpips_change"] == ""  # there are no weights here
        assert float(small["write_seconds"]) > 0
    shown = capsys.readouterr().out
    assert shown == (tmp_path / "layouts.md").read_text()
    assert f"| tiny | our_2dgs | 3 | compact | {int(rows[1]['file_bytes']) / 1e6:.2f} |" in shown


def test_without_their_library_layouts_are_left_out_and_the_others_stay(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "gaussforge", None)
    why = "spz, sog, compressed-ply need the library gaussforge: pip install 'envgs-bench[viewers]'"
    assert main(["layouts", str(runs / "2dgs"), "--device", "cpu", "--out", str(tmp_path)]) == 0
    rows = csv.DictReader((tmp_path / "layouts.csv").open())
    assert [row["layout"] for row in rows] == ["ply", "compact", "ply-two-scales"]
    assert capsys.readouterr().err.count(f"envgs-bench layouts: left out: {why}\n") == 1
    for command in ("layouts", "store"):  # one that was asked for cannot be left out
        assert main([command, str(runs / "2dgs"), "--layout", "spz", "--out", str(tmp_path / "asked")]) == 1
        assert f"envgs-bench {command}: {why}\n" in capsys.readouterr().err
        assert not (tmp_path / "asked").exists()


def test_what_has_no_place_for_a_part_has_a_size_and_no_score(runs: Path, tmp_path: Path) -> None:
    pytest.importorskip("gaussforge")
    assert main(["layouts", str(runs / "envgs"), "--layout", "spz", "--device", "cpu", "--out", str(tmp_path)]) == 0
    (row,) = csv.DictReader((tmp_path / "layouts.csv").open())
    assert (row["lacks"], row["read_seconds"]) == ("β", "")
    assert int(row["file_bytes"]) > 0
    assert "| spz (no place for β) |" in (tmp_path / "layouts.md").read_text()


def test_a_file_in_the_place_of_the_folder_names_out(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    for command in (["store", str(runs / "envgs"), "--layout", "ply"], ["layouts", str(runs)]):
        assert main([*command, "--out", str(tmp_path / "file")]) == 1
        shown = capsys.readouterr().err
        assert f"{command[0]}: --out {tmp_path / 'file'}: cannot be written (File exists: " in shown
        assert "left out" not in shown  # it is said before anything is computed


def test_sets_of_two_models_are_not_mixed_in_one_folder(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A base set beside the environment of another run: a viewer would show both as one model."""
    out = ["--layout", "ply", "--out", str(tmp_path / "out")]
    for _ in range(2):
        assert main(["store", str(runs / "envgs"), *out]) == 0
    base = (tmp_path / "out/base.ply").read_bytes()
    assert main(["store", str(runs / "2dgs"), *out]) == 1
    assert f"{tmp_path / 'out'}: holds env.ply of another model; give a new folder as --out" in capsys.readouterr().err
    assert (tmp_path / "out/base.ply").read_bytes() == base


def test_a_stored_model_takes_the_checkpoints_place(runs: Path, tmp_path: Path) -> None:
    """Every command that opens a run opens one that has nothing but the compact file."""
    assert main(["store", str(runs / "envgs"), "--layout", "compact", "--out", str(tmp_path / CHECKPOINT)]) == 0
    (tmp_path / "config.yaml").write_text((runs / "envgs" / "config.yaml").read_text())
    _, small = reopen(tmp_path, "cpu")
    _, whole = reopen(runs / "envgs", "cpu")
    assert small.primitives() == whole.primitives()
    camera = tiny_scene().test[0].camera
    difference = (small.render(camera).color - whole.render(camera).color).abs()
    assert 0 < difference.mean() < 0.01
    cost = with_files(COST, whole, runs / "envgs" / CHECKPOINT)
    assert cost.checkpoint_bytes == (runs / "envgs" / CHECKPOINT / "model.pt").stat().st_size
    assert cost.compact_bytes == (tmp_path / CHECKPOINT / compact.FILE_NAME).stat().st_size
    assert cost.model_bytes == COST.model_bytes


def test_a_model_that_cannot_be_made_compact_has_no_such_size(runs: Path) -> None:
    _, method = reopen(runs / "2dgs", "cpu")
    with torch.no_grad():
        method.model.sets["base"].parameters.tensors["means"][0] = torch.nan
    assert with_files(COST, method, runs / "2dgs" / CHECKPOINT).compact_bytes is None


@pytest.mark.parametrize("command", ["store", "layouts"])
def test_unknown_layouts_are_named(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    assert main([command, str(runs / "envgs"), "--layout", "zip", "--out", str(tmp_path)]) == 1
    assert "unknown layout 'zip': the known ones are ply, compact, spz, sog, compressed-ply" in capsys.readouterr().err


def test_what_is_left_out_is_said(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("gaussforge")
    assert main(["store", str(runs / "envgs"), "--layout", "spz", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr()
    assert said.out.split() == [str(tmp_path / f"{name}.spz") for name in ("base", "env")]
    assert said.err == "envgs-bench store: spz has no place for β: left out\n"


COST = Cost(
    primitives={"base": 1, "env": 0},
    bytes={"base": 152, "env": 0},
    model_bytes=152,
    train_seconds=1,
    peak_host_bytes=1,
    peak_device_bytes=None,
    skipped_steps=0,
    peak_primitives=1,
)


def test_a_model_whose_world_is_not_its_datas_says_so(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = Path(shutil.copytree(runs / "2dgs", tmp_path / "run"))
    placement = {"shift": [500123.0, 5600456.0, 312.0], "scale": 0.5}
    (run / "record.json").write_text(json.dumps(record("tiny", "2dgs", 3, placement=placement)))
    assert main(["store", str(run), "--layout", "ply", "--out", str(tmp_path / "out")]) == 0
    assert "a place of the data is (500123, 5600456, 312) + 0.5 · world" in capsys.readouterr().err
    assert json.loads((tmp_path / "out/placement.json").read_text()) == placement
    with pytest.raises(ValueError, match=r"was trained where a place of the data is \(500123, .* run it again"):
        next(layout_losses(run, require_layouts(["ply"]), "cpu"))
