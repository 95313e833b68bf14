"""Blender scenes: against positions worked out by hand, and what 3DGS's code base does with them."""

from __future__ import annotations

import json
import logging
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from envgs_bench.core import Scene
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.formats.normal_maps import NormalMap

SIZE = 40
ANGLE = 2 * math.atan(0.5)  # a focal length of SIZE pixels
NORMAL = np.array([0.6, 0.48, 0.64])

needs_captures = pytest.mark.skipif(
    "ENVGS_BENCH_DATA" not in os.environ, reason="ENVGS_BENCH_DATA names no folder of real captures"
)


def load(root: Path, **settings: Any) -> Scene:
    return load_scene({"kind": "blender", "root": str(root), **settings}, root.parent / "cache")


def refused(root: Path, message: str, **settings: Any) -> None:
    with pytest.raises(DatasetError, match=message):
        load(root, **settings)


def rgba(alpha: int = 255) -> np.ndarray:
    pixels = np.empty((SIZE, SIZE, 4), dtype=np.uint8)
    pixels[:] = [200, 100, 0, alpha]
    pixels[: SIZE // 2, :, 3] = 0
    return pixels


def pose(index: int) -> list[list[float]]:
    """The camera stands on the z axis, farther for each frame, unturned: it looks along -z, with y up."""
    return [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4.0 + index], [0, 0, 0, 1]]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Three training and two test views, as NeRF's files name them."""
    root = tmp_path / "ball"
    for split, count in (("train", 3), ("test", 2)):
        (root / split).mkdir(parents=True)
        frames = []
        for index in range(count):
            Image.fromarray(rgba()).save(root / split / f"r_{index}.png")
            frames.append({"file_path": f"./{split}/r_{index}", "rotation": 0.01, "transform_matrix": pose(index)})
        write(root, split, {"camera_angle_x": ANGLE, "frames": frames})
    for name in ("r_0_disp.tiff", "r_0_alpha.png"):
        (root / "test" / name).write_bytes(b"")  # beside the pictures of Ref-NeRF's scenes, and never opened
    return root


def write(root: Path, split: str, content: dict[str, Any]) -> None:
    (root / f"transforms_{split}.json").write_text(json.dumps(content))


def content(root: Path, split: str) -> dict[str, Any]:
    return json.loads((root / f"transforms_{split}.json").read_text())


def test_split_cameras_and_background(root: Path) -> None:
    scene = load(root)
    assert scene.name == "ball"
    assert [view.name for view in scene.train] == ["train_r_0", "train_r_1", "train_r_2"]
    assert [view.name for view in scene.test] == ["test_r_0", "test_r_1"]
    view = scene.train[1]
    np.testing.assert_allclose(view.camera.intrinsics, [[SIZE, 0, 20], [0, SIZE, 20], [0, 0, 1]], rtol=1e-6)
    np.testing.assert_allclose(view.camera.center, [0, 0, 5], atol=1e-6)
    pixels, depth = view.camera.project(torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]))
    np.testing.assert_allclose(pixels, [[20, 20], [20 + SIZE / 5, 20], [20, 20 - SIZE / 5]], rtol=1e-5)
    np.testing.assert_allclose(depth, 5, rtol=1e-6)
    assert (view.image[: SIZE // 2] == 255).all()
    assert (view.image[SIZE // 2 :] == torch.tensor([200, 100, 0])).all()
    assert (load(root, background=[0, 0, 0]).train[1].image[: SIZE // 2] == 0).all()


def test_half_transparent_pixels_are_mixed_and_then_shrunk(root: Path) -> None:
    Image.fromarray(rgba(alpha=51)).save(root / "train/r_0.png")
    view = load(root, downsample=2).train[0]
    assert view.image.shape == (SIZE // 2, SIZE // 2, 3)
    np.testing.assert_allclose(view.camera.intrinsics, [[20, 0, 10], [0, 20, 10], [0, 0, 1]], rtol=1e-6)
    mixed = 0.2 * np.array([200, 100, 0]) + 0.8 * 255
    np.testing.assert_allclose(view.image[-1, -1], mixed, atol=0.51)


def test_random_points_fill_the_box_in_gray(root: Path) -> None:
    scene = load(root)
    assert len(scene.points) == 100_000
    assert scene.points.abs().max() <= 1.3
    np.testing.assert_allclose(scene.points.std(dim=0), 1.3 / math.sqrt(3), rtol=0.01)
    coefficients = (scene.point_colors.double() - 0.5) / 0.28209479 * 255
    np.testing.assert_allclose([coefficients.min(), coefficients.max()], [0, 1], atol=1e-3)
    few = load(root, random_points=10, random_box=0.1).points
    assert (len(few), bool((few.abs() <= 0.1).all())) == (10, True)
    assert torch.equal(load(root, random_points=10, random_box=0.1, name="again").points, few)


def test_a_point_cloud_beside_the_files_is_used(root: Path) -> None:
    (root / "points3d.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n0 1 2 255 0 51\n-1 0.5 0 0 0 0\n"
    )
    scene = load(root)
    np.testing.assert_allclose(scene.points, [[0, 1, 2], [-1, 0.5, 0]])
    np.testing.assert_allclose(scene.point_colors, [[1, 0, 0.2], [0, 0, 0]], rtol=1e-6)


def srgb(linear: np.ndarray) -> np.ndarray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.abs(linear) ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("encoding", ["signed", "clamped", "array"])
def test_exact_normals_are_for_the_test_views(root: Path, encoding: str) -> None:
    """As Ref-NeRF's scenes store them, as NeRF's do (a component below 0 is lost), and as floats."""
    for split, count in (("train", 3), ("test", 2)):
        for index in range(count):
            normals = np.broadcast_to(NORMAL, (SIZE, SIZE, 3)).copy()
            normals[:, :8] = [-0.6, 0.0, 0.8]
            stem = root / split / f"r_{index}_normal"
            if encoding == "array":
                np.save(f"{stem}.npy", normals.astype(np.float32))
            else:
                coded = normals / 2 + 0.5 if encoding == "signed" else srgb(np.maximum(normals, 0))
                Image.fromarray(np.round(255 * coded).astype(np.uint8)).save(f"{stem}.png")
    scene = load(root)
    assert all(view.normal is None for view in scene.train)
    lower = scene.test[0].normal[SIZE // 2 :]
    np.testing.assert_allclose(lower[:, 8:], np.broadcast_to(NORMAL, lower[:, 8:].shape), atol=0.01)
    left = [0, 0, 0] if encoding == "clamped" else [-0.6, 0, 0.8]
    np.testing.assert_allclose(lower[:, :8], np.broadcast_to(left, lower[:, :8].shape), atol=0.01)
    assert (scene.test[0].normal[: SIZE // 2] == 0).all()  # nothing is there
    assert all(view.normal is not None for view in load(root, train_normals=True).train)


def test_a_folder_of_normals_is_no_ground_truth(root: Path) -> None:
    """As an estimator leaves one; test views are held to what was rendered with them."""
    for split, count in (("train", 3), ("test", 2)):
        (root / "normals" / split).mkdir(parents=True)
        for index in range(count):
            guess = np.full((SIZE, SIZE, 3), [0, 0, -1], np.float32)
            np.save(root / "normals" / split / f"r_{index}.npy", guess)
    scene = load(root)
    assert all(view.normal is None for view in [*scene.train, *scene.test])


def test_masks_are_found_by_split(root: Path) -> None:
    for split, count in (("train", 3), ("test", 2)):
        (root / "masks_metal" / split).mkdir(parents=True)
        for index in range(count):
            mask = np.zeros((SIZE, SIZE), dtype=np.uint8)
            mask[: 5 + index] = 255
            Image.fromarray(mask).save(root / "masks_metal" / split / f"r_{index}.png")
    scene = load(root)
    assert [int(view.masks["metal"].sum()) for view in scene.train] == [5 * SIZE, 6 * SIZE, 7 * SIZE]


def test_missing_files_are_refused_or_left_out(root: Path, caplog: pytest.LogCaptureFixture) -> None:
    (root / "train/r_1.png").unlink()
    refused(root, r"transforms_train\.json: 1 of 3 images .* not there: train/r_1; .*dataset\.missing=skip")
    for _ in range(2):  # the second time, from the cache
        caplog.clear()
        assert [view.name for view in load(root, missing="skip").train] == ["train_r_0", "train_r_2"]
        assert "1 of 3 images that it names are not there: train/r_1; left out" in caplog.text
    assert caplog.records[0].levelno == logging.WARNING
    (root / "transforms_test.json").unlink()
    refused(root, r"transforms_test\.json: there is no such file")


def test_unusable_files_are_named(root: Path) -> None:
    good = content(root, "train")
    write(root, "train", {"frames": good["frames"]})
    refused(root, r"transforms_train\.json: gives no focal length for r_0\.png")
    write(root, "train", {**good, "camera_angle_x": "wide"})
    refused(root, r"camera_angle_x='wide', expected a finite number")
    write(root, "train", {**good, "frames": []})
    refused(root, r"transforms_train\.json: lists no frames")
    (root / "transforms_train.json").write_text("{")
    refused(root, r"transforms_train\.json: cannot be read as JSON")


@pytest.mark.parametrize("name", ["../secret/r_0", "/etc/r_0", "train/../../r_0", "C:\\r_0"])
def test_names_that_climb_out_of_the_folder_are_refused(root: Path, name: str) -> None:
    Image.fromarray(rgba()).save(root.parent / "r_0.png")
    given = content(root, "train")
    given["frames"][0]["file_path"] = name
    write(root, "train", given)
    refused(root, r"transforms_train\.json: names a file outside its folder")


def test_an_invalid_pose_is_refused(root: Path) -> None:
    given = content(root, "test")
    for matrix, message in (
        ([[1, 0], [0, 1]], "is no camera-to-world matrix"),
        (np.diag([1.0, 1.0, math.nan, 1.0]).tolist(), "is no camera-to-world matrix"),
        (np.diag([1.0, 1.0, 0.0, 1.0]).tolist(), "is no camera-to-world matrix"),
        (np.diag([2.0, 1.0, 1.0, 1.0]).tolist(), "is no rotation"),
        (np.diag([-1.0, 1.0, 1.0, 1.0]).tolist(), "mirrors"),
        (np.diag([1.0, 1.0, 1.0, 2.0]).tolist(), "last row"),
    ):
        given["frames"][1]["transform_matrix"] = matrix
        write(root, "test", given)
        refused(root, rf"test/r_1.*{message}")


def test_rotations_of_three_decimals_become_the_nearest(root: Path) -> None:
    """Rays take the transpose of what projections take: with the matrix as given they would miss by half a pixel."""
    given, turn = content(root, "test"), Rotation.from_euler("xyz", [20, -35, 50], degrees=True).as_matrix()
    for index, decimals in enumerate((3, 7)):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turn.round(decimals), [0.5, -0.25, 4.0]
        given["frames"][index]["transform_matrix"] = matrix.tolist()
    write(root, "test", given)
    for view, error in zip(load(root).test, (1e-3, 1e-6), strict=True):
        pose = view.camera.world_to_camera[:3, :3].double().numpy()
        np.testing.assert_allclose(pose @ pose.T, np.eye(3), rtol=0, atol=1e-6)
        np.testing.assert_allclose(pose, (turn @ np.diag([1, -1, -1])).T, rtol=0, atol=error)


def test_one_picture_of_another_size(root: Path) -> None:
    Image.fromarray(rgba()).resize((20, 20)).save(root / "train/r_2.png")
    refused(root, r"several sizes \(40×40: train/r_0\.png, train/r_1\.png; 20×20: train/r_2\.png\)")


@needs_captures
def test_a_real_scene_s_views_agree(tmp_path: Path) -> None:
    """Points that every training view sees opaque exist, and test views see those opaque too; its exact normals, which
    nothing has turned yet, face the cameras."""
    root = Path(os.environ["ENVGS_BENCH_DATA"]) / "nerf_synthetic_chair"
    if not root.is_dir():
        pytest.skip(f"{root} is not there")
    scene = load_scene({"kind": "blender", "root": str(root), "downsample": 2, "random_points": 20_000}, tmp_path)
    assert (len(scene.train), len(scene.test)) == (100, 50)
    inside = torch.ones(len(scene.points), dtype=torch.bool)
    for view in scene.train[::5]:
        inside &= sees_opaque(root, view.name, scene.points, view)
    assert inside.sum() > 200
    for view in scene.test[::10]:
        assert sees_opaque(root, view.name, scene.points[inside], view).float().mean() > 0.9
        path = root / view.name.replace("test_", "test/")
        stored = NormalMap(path.with_name(f"{path.name}_normal.png"), rendered=True).read(
            alpha_of(root, view.name) == 255
        )
        toward = -torch.nn.functional.interpolate(view.camera.rays()[1].permute(2, 0, 1)[None], scale_factor=2)[0]
        facing = (torch.from_numpy(stored) * toward.permute(1, 2, 0)).sum(-1)[np.linalg.norm(stored, axis=-1) > 0.5]
        assert len(facing) > 5_000
        assert (facing > -0.01).float().mean() > 0.999


def sees_opaque(root: Path, name: str, points: torch.Tensor, view: Any) -> torch.Tensor:
    alpha = torch.from_numpy(alpha_of(root, name))
    camera = view.camera.resized(alpha.shape[1], alpha.shape[0])
    column, row = camera.project(points)[0].long().unbind(-1)
    return alpha[row.clamp(0, alpha.shape[0] - 1), column.clamp(0, alpha.shape[1] - 1)] > 0


def alpha_of(root: Path, name: str) -> np.ndarray:
    split, _, stem = name.partition("_")
    with Image.open(root / split / f"{stem}.png") as image:
        return np.asarray(image)[..., 3].copy()
