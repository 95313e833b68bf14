"""Exports: what is read back is the same benchmark, and what other programs would read is what was meant."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch
from hydra.core.override_parser.overrides_parser import OverridesParser
from PIL import Image
from plyfile import PlyData
from scipy.spatial.transform import Rotation
from toy_scenes import rough_toys

from envgs_bench.cli.main import main
from envgs_bench.core import Camera, Scene, View
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.export import FORMATS, export_scene
from envgs_bench.datasets.export.rotation import exact_rotation
from envgs_bench.datasets.toy.scenes import SCENES
from envgs_bench.methods.registry import create_method
from envgs_bench.metrics import get_protocol
from envgs_bench.stages.evaluation import evaluate
from envgs_bench.stages.training import Training

TINY = {"kind": "toy", "width": 24, "height": 16, "views": 10, "supersampling": 1, "normal_noise": 8.0}
Load = Callable[[str], Scene]


@pytest.fixture(scope="module")
def load(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Load]:
    cache = tmp_path_factory.mktemp("cache")
    with rough_toys():
        yield lambda name: load_scene({**TINY, "scene": name}, cache)


def views_of(scene: Scene) -> list[View]:
    return [*scene.train, *scene.test]


def round_trip(scene: Scene, form: str, folder: Path) -> Scene:
    return load_scene(export_scene(scene, folder / "data", form), folder / "cache")


def assert_same(scene: Scene, again: Scene) -> None:
    """Everything but depth and the beginnings of the views' names, to the last bit."""
    assert again.name == scene.name
    assert torch.equal(again.points, scene.points)
    assert torch.equal(again.point_colors, scene.point_colors)
    assert torch.equal(again.background, scene.background)
    assert (len(again.train), len(again.test)) == (len(scene.train), len(scene.test))
    regions = {region for view in views_of(scene) for region, mask in view.masks.items() if mask.any()}
    for ours, theirs in zip(views_of(scene), views_of(again), strict=True):
        assert theirs.name.endswith(ours.name)
        assert torch.equal(theirs.image, ours.image)
        assert torch.equal(theirs.camera.world_to_camera, ours.camera.world_to_camera)
        assert torch.equal(theirs.camera.intrinsics, ours.camera.intrinsics)
        assert (theirs.camera.width, theirs.camera.height) == (ours.camera.width, ours.camera.height)
        assert set(theirs.masks) == regions  # black where a view lacks one, which scores nothing either
        nothing = torch.zeros(ours.image.shape[:2], dtype=torch.bool)
        assert all(torch.equal(mask, ours.masks.get(region, nothing)) for region, mask in theirs.masks.items())
        assert (theirs.normal is None) == (ours.normal is None)
        assert ours.normal is None or torch.equal(theirs.normal, ours.normal)


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("name", SCENES)
def test_toy_scenes_read_back_bit_by_bit(load: Load, tmp_path: Path, name: str, form: str) -> None:
    scene = replace(load(name), background=torch.tensor([0.1, 0.7, 1.0]))
    assert_same(scene, round_trip(scene, form, tmp_path))


@pytest.mark.parametrize("form", FORMATS)
def test_the_same_method_gets_the_same_scores(load: Load, tmp_path: Path, form: str) -> None:
    scene = load("chrome_room")

    def scores(data: Scene, folder: Path) -> tuple[dict, dict]:
        folder.mkdir()
        method = create_method("envgs", {}, "cpu", seed=0)
        Training(method, data, steps=3, seed=0).run(folder / "curve.csv", lambda event: None)
        method.prepare()
        metrics, masked = evaluate(method, data.test, get_protocol("envgs"), folder, lambda event: None)
        return metrics.mean, {region: found.model_dump(exclude={"per_view"}) for region, found in masked.items()}

    first = scores(scene, tmp_path / "first")
    assert set(first[1]) == {"reflective", "near_field", "covisible"}
    assert scores(round_trip(scene, form, tmp_path), tmp_path / "again") == first


@pytest.mark.parametrize("seed", range(20))
def test_some_rotation_rounds_to_every_rounded_rotation(seed: int) -> None:
    matrix = Rotation.random(random_state=seed).as_matrix().astype(np.float32)
    found = exact_rotation(matrix)
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-15)
    through_quaternion = pycolmap.Rotation3d(Rotation.from_matrix(found).as_quat()).matrix()
    np.testing.assert_array_equal(through_quaternion.astype(np.float32), matrix)


def test_the_nearest_rotation_loses_bits() -> None:
    """The nearest rotation, which a plain conversion stores, mostly rounds to another matrix."""
    lost = 0
    for seed in range(20):
        matrix = Rotation.random(random_state=seed).as_matrix().astype(np.float32)
        nearest = Rotation.from_matrix(matrix.astype(np.float64)).as_matrix()
        lost += not np.array_equal(nearest.astype(np.float32), matrix)
    assert lost > 10


def test_zeros_of_a_rotation_stay_zero() -> None:
    """Upright cameras have some, and a quarter turn has four."""
    upright = Rotation.from_euler("xz", [100, 37], degrees=True).as_matrix()
    upright[np.abs(upright) < 1e-15] = 0
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for matrix in (upright.astype(np.float32), quarter.astype(np.float32)):
        assert (matrix == 0).any()
        found = exact_rotation(matrix)
        np.testing.assert_array_equal(np.where(np.abs(found) < 1e-15, 0, found).astype(np.float32), matrix)


def test_what_is_no_rotation_becomes_the_nearest(load: Load, tmp_path: Path) -> None:
    scene = load("sky_ball")
    bent = scene.train[0].camera.world_to_camera.clone()
    bent[:3, :3] *= 1 + 3e-6
    view = replace(scene.train[0], camera=replace(scene.train[0].camera, world_to_camera=bent))
    again = round_trip(replace(scene, train=[view, *scene.train[1:]]), "colmap", tmp_path)
    torch.testing.assert_close(again.train[0].camera.world_to_camera, bent, atol=4e-6, rtol=0)


def pixel_of(camera: Camera, point: torch.Tensor) -> np.ndarray:
    return camera.project(point)[0].double().numpy()


def test_a_text_model_says_in_colmaps_terms_where_points_are_seen(load: Load, tmp_path: Path) -> None:
    """Parsed by hand after COLMAP's documentation: QW QX QY QZ TX TY TZ, PINHOLE fx fy cx cy, x = K(Rp + t)."""
    scene = load("thin_rails")
    export_scene(scene, tmp_path / "data", "colmap-text")
    folder = tmp_path / "data/sparse/0"

    def rows(name: str) -> list[list[str]]:
        return [line.split() for line in (folder / name).read_text().splitlines() if line and line[0] != "#"]

    (camera,) = rows("cameras.txt")
    assert camera[1:4] == ["PINHOLE", "24", "16"]
    fx, fy, cx, cy = map(float, camera[4:])
    images = {row[-1]: [float(number) for number in row[1:8]] for row in rows("images.txt") if len(row) == 10}
    assert sorted(images) == [f"{index:04d}.png" for index in range(10)]
    points = rows("points3D.txt")
    assert len(points) == len(scene.points)
    first = next(row for row in points if row[0] == "1")
    np.testing.assert_array_equal(np.float32(first[1:4]), scene.points[0])
    np.testing.assert_allclose([int(channel) / 255 for channel in first[4:7]], scene.point_colors[0], atol=1e-7)
    for view in views_of(scene):
        qw, qx, qy, qz, *translation = images[f"{view.name}.png"]
        x, y, z = Rotation.from_quat([qx, qy, qz, qw]).apply(np.float64(first[1:4])) + translation
        np.testing.assert_allclose(
            [fx * x / z + cx, fy * y / z + cy], pixel_of(view.camera, scene.points[0]), atol=2e-3
        )
        stored = np.asarray(Image.open(tmp_path / f"data/images/{view.name}.png"))
        np.testing.assert_array_equal(stored, view.image)
        mask = np.asarray(Image.open(tmp_path / f"data/masks_near_field/{view.name}.png"))
        np.testing.assert_array_equal(mask, 255 * view.masks["near_field"].numpy())


def test_transforms_say_in_nerfs_terms_where_points_are_seen(load: Load, tmp_path: Path) -> None:
    """As NeRF's code reads them: focal = W/2 / tan(angle/2), rays (x − W/2, −(y − H/2), −focal), camera to world."""
    scene = load("facing_mirrors")
    export_scene(scene, tmp_path / "data", "blender")
    vertices = PlyData.read(str(tmp_path / "data/points3d.ply"))["vertex"]
    np.testing.assert_array_equal(np.stack([vertices[axis] for axis in "xyz"], 1), scene.points)
    assert vertices["red"].dtype == np.uint8
    for split, views in (("train", scene.train), ("test", scene.test)):
        content = json.loads((tmp_path / f"data/transforms_{split}.json").read_text())
        assert [frame["file_path"] for frame in content["frames"]] == [f"./{split}/{view.name}" for view in views]
        focal = 12 / np.tan(content["camera_angle_x"] / 2)
        for frame, view in zip(content["frames"], views, strict=True):
            in_camera = np.linalg.inv(frame["transform_matrix"]) @ [*scene.points[5].double(), 1]
            pixel = [12 - focal * in_camera[0] / in_camera[2], 8 + focal * in_camera[1] / in_camera[2]]
            np.testing.assert_allclose(pixel, pixel_of(view.camera, scene.points[5]), atol=2e-3)
            stored = np.asarray(Image.open(tmp_path / f"data/{split}/{view.name}.png"))
            np.testing.assert_array_equal(stored, view.image)


def test_cameras_of_their_own_intrinsics_survive(load: Load, tmp_path: Path) -> None:
    scene = load("sky_ball")
    intrinsics = torch.tensor([[30.5, 0, 15.1], [0, 31.7, 12.4], [0, 0, 1]])
    view = replace(scene.train[2], camera=replace(scene.train[2].camera, intrinsics=intrinsics))
    changed = replace(scene, train=[*scene.train[:2], view, *scene.train[3:]])
    for form in FORMATS:
        assert_same(changed, round_trip(changed, form, tmp_path / form))


def test_a_split_of_its_own_needs_blenders_layout(load: Load, tmp_path: Path) -> None:
    scene = load("sky_ball")
    moved = replace(scene, train=scene.train[1:], test=[*scene.test, scene.train[0]])
    with pytest.raises(DatasetError, match=r"not every 8th by name.*--format blender"):
        export_scene(moved, tmp_path / "data", "colmap")
    assert_same(moved, round_trip(moved, "blender", tmp_path))


def test_views_that_lack_a_region_or_normals(load: Load, tmp_path: Path) -> None:
    """A missing region becomes an empty one, which scores nothing either; blender's layout keeps normals a view."""
    scene = load("sky_ball")
    bare = replace(scene.test[0], masks={})
    again = round_trip(replace(scene, test=[bare, *scene.test[1:]]), "colmap", tmp_path / "one")
    assert not any(mask.any() for mask in again.test[0].masks.values())
    assert_same(
        unlit := replace(scene, train=[replace(view, normal=None) for view in scene.train]),
        round_trip(unlit, "blender", tmp_path / "two"),
    )


@pytest.mark.parametrize("form", FORMATS)
def test_guessed_normals_stay_with_the_training_views(load: Load, tmp_path: Path, form: str) -> None:
    """As captures have them whose normals are not exact; and some that only a few views have."""
    scene = load("sky_ball")
    guessed = replace(scene, test=[replace(view, normal=None) for view in scene.test])
    assert_same(guessed, round_trip(guessed, form, tmp_path / "one"))
    some = replace(guessed, train=[replace(guessed.train[0], normal=None), *guessed.train[1:]])
    again = round_trip(some, form, tmp_path / "two")
    assert again.train[0].normal is None or not again.train[0].normal.any()
    assert torch.equal(again.train[1].normal, scene.train[1].normal)


def test_nothing_is_left_of_an_export_that_fails(load: Load, tmp_path: Path) -> None:
    scene = load("sky_ball")
    skewed = scene.train[-1].camera.intrinsics.clone()
    skewed[0, 1] = 0.5
    view = replace(scene.train[-1], camera=replace(scene.train[-1].camera, intrinsics=skewed))
    for form in FORMATS:
        with pytest.raises(DatasetError, match=r"skew of 0\.5"):
            export_scene(replace(scene, train=[*scene.train[:-1], view]), tmp_path / "data", form)
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_is_not_overwritten(load: Load, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("kept")
    with pytest.raises(DatasetError, match="is there already; give a new or an empty folder"):
        export_scene(load("sky_ball"), tmp_path, "colmap")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    with pytest.raises(DatasetError, match="'nerf' is unknown: expected one of colmap, colmap-text, blender"):
        export_scene(load("sky_ball"), tmp_path / "data", "nerf")


@pytest.mark.parametrize("form", FORMATS)
def test_the_command_says_how_to_read_it(tmp_path: Path, capsys: pytest.CaptureFixture[str], form: str) -> None:
    data = ["dataset=toy/sky_ball", "dataset.width=16", "dataset.height=16", "dataset.views=3"]
    with rough_toys():
        status = main(
            ["export", *data, "--format", form, "--out", str(tmp_path / "data"), f"cache_dir={tmp_path}/cache"]
        )
    printed = capsys.readouterr()
    assert status == 0, printed.err
    assert "2 training and 1 test views" in printed.out
    assert "cameras read back bit by bit" in printed.out
    source = "blender" if form == "blender" else "colmap"
    assert f"envgs-bench run dataset={source} dataset.root={tmp_path}/data dataset.name=toy/sky_ball" in printed.out


@pytest.mark.parametrize("folder", ["it's here (1), α=½", "123", "plain"])
def test_the_command_it_prints_names_the_folder_whatever_its_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], folder: str
) -> None:
    data = ["dataset=toy/sky_ball", "dataset.width=16", "dataset.height=16", "dataset.views=3"]
    with rough_toys():
        assert main(["export", *data, "--out", str(tmp_path / folder), f"cache_dir={tmp_path}/cache"]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("read it with: "))
    words = shlex.split(line.removeprefix("read it with: envgs-bench run "))
    given = {item.key_or_group: item.value() for item in OverridesParser.create().parse_overrides(words)}
    assert given["dataset.root"] == str(tmp_path / folder)
    assert given["dataset.background"] == [0, 0, 0]
    assert given["dataset.exact_normals"] is True


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["dataset=toy/sky_bal"], "Did you mean 'sky_ball'?"),
        (["dataset=toy/sky_ball", "dataset.widht=3"], "unknown key 'dataset.widht'"),
        (["dataset=colmap"], "dataset.root is missing"),
    ],
)
def test_wrong_arguments_of_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert main(["export", *arguments, "--out", str(tmp_path / "data")]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif("ENVGS_BENCH_DATA" not in os.environ, reason="ENVGS_BENCH_DATA names no folder of real captures")
@pytest.mark.parametrize(
    ("name", "form"), [("lund_door", "colmap"), ("lund_door", "blender"), ("colmap_fox9", "colmap"), ("fox", "colmap")]
)
def test_real_captures_read_back_bit_by_bit(tmp_path: Path, name: str, form: str) -> None:
    """Poses that another program solved for, undistorted intrinsics, a principal point off the middle."""
    root = Path(os.environ["ENVGS_BENCH_DATA"]) / name
    if not root.is_dir():
        pytest.skip(f"{root} is not there")
    scene = load_scene({"kind": "colmap", "root": str(root), "downsample": 16}, tmp_path / "cache")
    assert_same(scene, round_trip(scene, form, tmp_path))
