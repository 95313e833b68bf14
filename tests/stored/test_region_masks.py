"""`envgs-bench masks` and the files it writes: read back by the data sources as they were drawn."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from captures import PINHOLE, write_capture
from fakes.methods import MeanColor, Settings
from fakes.runs import only_folder, run_job_here, set_environment
from PIL import Image

from envgs_bench.cli.main import main
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.export.masks import write_masks
from envgs_bench.diagnosis.reflection_score import Surface
from envgs_bench.methods.envgs import EnvGS, EnvGSSettings
from envgs_bench.methods.storage.ply import read_ply
from envgs_bench.records import read_record
from envgs_bench.settings import MethodChoice, read_settings
from envgs_bench.stored import region_masks
from envgs_bench.testing import tiny_scene

NAMES = ["left/1.png", "left/2.jpg", "right/1.png", "right/2.png"]
TRAINED = ("method=envgs", "steps=12")


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


def blob(height: int, width: int, index: int = 0) -> np.ndarray:
    """An ellipse, another one for each view."""
    y, x = np.mgrid[0:height, 0:width]
    return (((x - (0.4 + 0.05 * index) * width) / (0.38 * width)) ** 2 + ((y - height / 2) / (0.4 * height)) ** 2) < 1


def surely(mask: np.ndarray) -> np.ndarray:
    """Pixels whose neighbors are all inside or all outside, as they are."""
    around = np.stack([np.roll(mask, shift, axis) for axis in (0, 1) for shift in (-1, 1)])
    return (around == mask).all(axis=0)


@pytest.mark.parametrize("downsample", [1, 2])
def test_masks_of_pinholes_read_back_bit_by_bit(tmp_path: Path, downsample: int) -> None:
    root = write_capture(tmp_path / "capture", NAMES, PINHOLE)
    settings = {"kind": "colmap", "root": str(root), "downsample": downsample}
    scene = load_scene(settings, tmp_path / "cache")
    views = [*scene.train, *scene.test]
    masks = {view.name: blob(view.camera.height, view.camera.width, i) for i, view in enumerate(views)}
    paths = write_masks(settings, tmp_path / "cache", masks, root / "masks_reflective")
    assert {path.relative_to(root / "masks_reflective").as_posix() for path in paths} == {
        "left/1.png",
        "left/2.png",
        "right/1.png",
        "right/2.png",
    }
    again = load_scene(settings, tmp_path / "cache")
    for view in [*again.train, *again.test]:
        assert np.array_equal(view.masks["reflective"].numpy(), masks[view.name])


def test_masks_of_distorted_photographs_are_distorted_by_the_cameras_formula_and_come_back(tmp_path: Path) -> None:
    k1, k2 = -0.3, 0.08
    root = write_capture(tmp_path / "capture", NAMES, f"OPENCV 64 48 60.0 62.0 30.5 25.0 {k1} {k2} 0 0")
    settings = {"kind": "colmap", "root": str(root)}
    scene = load_scene(settings, tmp_path / "cache")
    views = [*scene.train, *scene.test]
    masks = {view.name: blob(view.camera.height, view.camera.width) for view in views}
    write_masks(settings, tmp_path / "cache", masks, root / "masks_reflective")
    with Image.open(root / "masks_reflective" / "left" / "1.png") as image:
        stored = np.asarray(image) > 0
    assert stored.shape == (48, 64)
    camera, drawn = views[0].camera, masks[views[0].name]
    sure = surely(drawn)
    _, directions = camera.rays()
    x, y = (directions @ camera.world_to_camera[:3, :3].T)[..., :2].double().numpy().transpose(2, 0, 1)
    squared = x**2 + y**2
    stretch = 1 + k1 * squared + k2 * squared**2
    columns, rows = 60 * x * stretch + 30.5, 62 * y * stretch + 25
    moved = np.hypot(columns - 60 * x - 30.5, rows - 62 * y - 25)
    assert moved[drawn].max() > 1  # pixels: enough to tell a distorted mask from one that is not
    at = stored[np.clip(rows.astype(int), 0, 47), np.clip(columns.astype(int), 0, 63)]
    assert np.array_equal(at[sure], drawn[sure])
    again = load_scene(settings, tmp_path / "cache")
    for view in [*again.train, *again.test]:
        wrong = view.masks["reflective"].numpy() != masks[view.name]
        assert not wrong[surely(masks[view.name])].any()
        assert wrong.mean() < 0.02


def test_masks_of_a_scene_that_has_changed_are_refused(tmp_path: Path) -> None:
    root = write_capture(tmp_path / "capture", NAMES, PINHOLE)
    settings = {"kind": "colmap", "root": str(root)}
    with pytest.raises(DatasetError, match="has no photograph of view middle_1; its files have changed"):
        write_masks(settings, tmp_path / "cache", {"middle_1": blob(48, 64)}, tmp_path / "masks")


def test_blender_and_transforms_scenes_read_their_masks_too(tmp_path: Path) -> None:
    """Poses do not matter here: where the files lie and what they hold does."""
    for kind, files, names in (
        ("blender", ("transforms_train.json", "transforms_test.json"), ("train/r_0", "test/r_0")),
        ("transforms", ("transforms.json",), ("images/a", "images/b")),
    ):
        root = tmp_path / kind
        frames = [{"file_path": name, "transform_matrix": np.eye(4).tolist()} for name in names]
        for index, name in enumerate(names):
            path = root / f"{name}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.new("RGB", (32, 24), (index, 0, 0)).save(path)
        for index, file in enumerate(files):
            chosen = frames if len(files) == 1 else [frames[index]]
            (root / file).write_text(json.dumps({"camera_angle_x": 0.8, "aabb_scale": 1, "frames": chosen}))
        settings = {"kind": kind, "root": str(root)}
        scene = load_scene(settings, tmp_path / "cache")
        masks = {view.name: blob(24, 32, i) for i, view in enumerate([*scene.train, *scene.test])}
        write_masks(settings, tmp_path / "cache", masks, root / "masks_near_field")
        again = load_scene(settings, tmp_path / "cache")
        for view in [*again.train, *again.test]:
            assert np.array_equal(view.masks["near_field"].numpy(), masks[view.name]), (kind, view.name)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run of EnvGS, far too short to know what reflects."""
    runs = tmp_path_factory.mktemp("trained")
    with pytest.MonkeyPatch.context() as patch:
        set_environment(patch)
        assert run_job_here(runs, *TRAINED) == 0
    return only_folder(runs)


def test_a_trained_run_gives_a_mask_a_view_and_says_how(trained: Path, tmp_path: Path) -> None:
    beta = ["--beta", "0.09"]  # below where it starts: everything in the middle counts as reflecting
    for region in ("reflective", "near_field"):
        assert main(["masks", str(trained), "--region", region, "--out", str(tmp_path), *beta, "--device", "cpu"]) == 0
    read = {
        region: {path.stem: np.asarray(Image.open(path)) for path in (tmp_path / f"masks_{region}").glob("*.png")}
        for region in ("reflective", "near_field")
    }
    assert len(read["reflective"]) == len(read["near_field"]) == 6
    for name, mask in read["reflective"].items():
        assert mask.shape == (24, 32)
        assert set(np.unique(mask)) <= {0, 255}
        assert (read["near_field"][name] <= mask).all()
    about = json.loads((tmp_path / "masks_reflective.json").read_text())
    assert about["run"] == str(trained)
    assert about["beta_min"] == 0.09
    assert 0 < about["foreground"]["primitives"] <= about["base_primitives"]
    assert about["mean_fraction"] == pytest.approx(np.mean([m.mean() / 255 for m in read["reflective"].values()]))


def test_what_cannot_give_masks_is_explained(trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def failing(folder: Path, *options: str) -> str:
        assert main(["masks", str(folder), "--region", "reflective", "--out", str(tmp_path), *options]) == 1
        return capsys.readouterr().err

    assert "lower --beta, or give the foreground as --foreground X Y Z RADIUS" in failing(trained, "--beta", "0.999")
    assert "has β > 0.2 within 0.1 of (90, 0, 0)" in failing(trained, "--foreground", "90", "0", "0", "0.1")
    assert "holds no config.yaml; expected the folder of one run" in failing(tmp_path)
    assert not list(tmp_path.glob("masks_*"))


def test_masks_that_somebody_else_made_are_kept(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    by_hand = tmp_path / "masks_reflective" / "view0.png"
    by_hand.parent.mkdir()
    by_hand.write_text("by hand")
    command = ["masks", str(trained), "--region", "reflective", "--beta", "0.09", "--device", "cpu", "--out"]
    assert main([*command, str(tmp_path)]) == 1
    assert "masks_reflective: is there already, and was not made by this command" in capsys.readouterr().err
    assert by_hand.read_text() == "by hand"
    for _ in range(2):  # its own it replaces
        assert main([*command, str(tmp_path / "other")]) == 0


def test_a_run_without_beta_is_refused(trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = MethodChoice(name="fake", kind="fakes.methods:MeanColor", settings={})
    settings = read_settings(trained).model_copy(update={"method": other})
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(settings.model_dump(mode="json")))
    method = MeanColor(Settings())
    method.initialize(tiny_scene(), 1)
    method.save(tmp_path / "checkpoint")
    assert main(["masks", str(tmp_path), "--region", "reflective", "--out", str(tmp_path)]) == 1
    assert "method fake has no sets of Gaussians that masks could be made by" in capsys.readouterr().err
    assert main(["store", str(tmp_path), "--layout", "ply", "--out", str(tmp_path)]) == 1
    assert "method fake has no sets of Gaussians to write" in capsys.readouterr().err


def test_the_sets_of_a_run_are_written_as_ply(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["store", str(trained), "--layout", "ply", "--out", str(tmp_path / "sets")]) == 0
    assert capsys.readouterr().out.split() == [str(tmp_path / "sets" / f"{name}.ply") for name in ("base", "env")]
    record = read_record(trained)
    assert record.cost is not None
    method = EnvGS(EnvGSSettings())
    method.load(trained / "checkpoint")
    for name, count in record.cost.primitives.items():
        read = read_ply(tmp_path / "sets" / f"{name}.ply")
        assert len(read["means"]) == count
        for key, values in method.model.sets[name].parameters.detached().items():
            assert torch.equal(read[key], values), (name, key)


def test_photographs_tell_what_reflects_on_the_surfaces_of_any_run(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["masks", str(trained), "--region", "reflective", "--by", "photographs", "--device", "cpu", "--out"]

    def score(own: Surface, others: list[Surface]) -> torch.Tensor:
        assert len(others) in (3, 4)  # of four training views, less its own
        assert not any(own is each for each in others)
        return torch.where(torch.arange(own.depth.shape[1]) < own.depth.shape[1] / 2, 1.0, 0.0).expand_as(own.depth)

    monkeypatch.setattr(region_masks, "reflection_score", score)
    assert main([*command, str(tmp_path)]) == 0
    mask = np.asarray(Image.open(next((tmp_path / "masks_reflective").glob("*.png"))))
    assert mask[:, :12].all()
    assert not mask[:, 20:].any()
    assert json.loads((tmp_path / "masks_reflective.json").read_text())["by"] == "photographs"
    monkeypatch.setattr(region_masks, "reflection_score", lambda own, others: torch.zeros_like(own.depth))
    assert main([*command, str(tmp_path / "none")]) == 1
    assert "nothing that reflects was found by photographs" in capsys.readouterr().err
    assert not list((tmp_path / "none").glob("*"))
    assert main([*command, str(tmp_path / "none"), "--beta", "0.1"]) == 1
    assert "--beta: photographs say nothing of that" in capsys.readouterr().err
