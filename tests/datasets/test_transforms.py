"""Captures with a transforms.json: the same as the COLMAP capture of the same cameras, however the file says it."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from captures import HEIGHT, OPENCV, PINHOLE, WIDTH, center_of, gradient, rotation_of, write_capture
from PIL import Image

from envgs_bench.core import Scene
from envgs_bench.datasets import DatasetError, load_scene

NAMES = [f"{index:03d}.png" for index in range(10)]
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\n"
    "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n0 1 2 255 0 51\n-1 0.5 0 0 0 0\n"
)
FLAT = {"fl_x": 60.0, "fl_y": 62.0, "cx": 30.5, "cy": 25.0, "w": WIDTH, "h": HEIGHT}
BENT = {**FLAT, "camera_model": "OPENCV", "k1": 0.06, "k2": -0.03, "p1": 0.002, "p2": -0.001}

needs_captures = pytest.mark.skipif(
    "ENVGS_BENCH_DATA" not in os.environ, reason="ENVGS_BENCH_DATA names no folder of real captures"
)


def load(root: Path, kind: str = "transforms", **settings: Any) -> Scene:
    return load_scene({"kind": kind, "root": str(root), **settings}, root.parent / "cache")


def refused(root: Path, message: str, **settings: Any) -> None:
    with pytest.raises(DatasetError, match=message):
        load(root, **settings)


def opengl_pose(index: int) -> list[list[float]]:
    """Camera to world; the camera's y and z axes point up and back."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_of(index).T @ np.diag([1, -1, -1])
    matrix[:3, 3] = center_of(index)
    return matrix.tolist()


def write(root: Path, shared: dict[str, Any], file: str = "transforms.json") -> Path:
    frames = [
        {"file_path": f"images/{name}", "transform_matrix": opengl_pose(index)} for index, name in enumerate(NAMES)
    ]
    (root / file).write_text(json.dumps({"aabb_scale": 4, "frames": frames, **shared}))
    return root


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-32"])
def test_byte_order_marks_change_nothing(root: Path, encoding: str) -> None:
    plain = load(write(root, FLAT))
    (root / "transforms.json").write_text((root / "transforms.json").read_text(), encoding=encoding)
    assert [view.name for view in load(root).train] == [view.name for view in plain.train]


@pytest.mark.parametrize("scale", [0.1, 30.0])
def test_a_scale_in_the_matrices_is_divided_out_and_noted(
    root: Path, scale: float, caplog: pytest.LogCaptureFixture
) -> None:
    plain = load(write(root, FLAT))
    for index in range(len(NAMES)):
        matrix = np.array(opengl_pose(index))
        matrix[:3, :3] *= scale
        change_frame(root, index, transform_matrix=matrix.tolist())
    scaled = load(root)
    assert f"of {len(NAMES)} frames scales its camera by {scale:g}" in caplog.text
    for ours, theirs in zip(scaled.train, plain.train, strict=True):
        torch.testing.assert_close(ours.camera.world_to_camera, theirs.camera.world_to_camera)


def change_frame(root: Path, index: int, **changes: Any) -> None:
    content = json.loads((root / "transforms.json").read_text())
    content["frames"][index].update(changes)
    (root / "transforms.json").write_text(json.dumps(content))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write(write_capture(tmp_path / "bench", NAMES), FLAT)


def assert_same_views(ours: Scene, theirs: Scene) -> None:
    for a, b in zip([*ours.train, *ours.test], [*theirs.train, *theirs.test], strict=True):
        assert a.name == b.name
        assert torch.equal(a.image, b.image)
        np.testing.assert_allclose(a.camera.world_to_camera, b.camera.world_to_camera, atol=1e-6)
        np.testing.assert_allclose(a.camera.intrinsics, b.camera.intrinsics, rtol=1e-6)


@pytest.mark.parametrize(
    ("camera", "shared"),
    [
        (PINHOLE, FLAT),
        (PINHOLE, {**FLAT, "camera_model": "PINHOLE", "k1": 0.0}),
        (OPENCV, BENT),
        (OPENCV, {key: value for key, value in BENT.items() if key != "camera_model"}),  # as instant-ngp writes it
        (
            "FULL_OPENCV 64 48 60.0 62.0 30.5 25.0 0.06 -0.03 0.002 -0.001 0.01 0 0 0",
            {**BENT, "k3": 0.01},
        ),
        (
            "OPENCV_FISHEYE 64 48 60.0 62.0 30.5 25.0 0.02 0.01 0.003 0.001",
            {**FLAT, "camera_model": "OPENCV_FISHEYE", "k1": 0.02, "k2": 0.01, "k3": 0.003, "k4": 0.001},
        ),
        (
            "OPENCV_FISHEYE 64 48 60.0 62.0 30.5 25.0 0.02 0.0 0.0 0.0",
            {**FLAT, "is_fisheye": True, "k1": 0.02},
        ),
        (
            "PINHOLE 64 48 60.0 62.0 32.0 24.0",
            {"camera_angle_x": 2 * math.atan(32 / 60), "camera_angle_y": 2 * math.atan(24 / 62)},
        ),
        ("PINHOLE 64 48 60.0 60.0 32.0 24.0", {"fl_x": 60.0}),
    ],
    ids=["pinhole", "named", "opencv", "instant-ngp", "k3", "fisheye", "is_fisheye", "angles", "one focal length"],
)
def test_cameras_are_those_of_the_same_colmap_model(tmp_path: Path, camera: str, shared: dict[str, Any]) -> None:
    root = write(write_capture(tmp_path / "bench", NAMES, camera), shared)
    assert_same_views(load(root, downsample=2), load(root, "colmap", downsample=2))


def test_a_frame_s_own_field_of_view_goes_before_a_shared_focal_length(root: Path) -> None:
    write(root, FLAT)
    change_frame(root, 1, camera_angle_x=2 * math.atan(32 / 70))
    views = {view.name: view for view in [*load(root).train, *load(root).test]}
    focal = {name: float(view.camera.intrinsics[0, 0]) for name, view in views.items()}
    assert focal["001"] == pytest.approx(70)
    assert focal["002"] == pytest.approx(60)


def test_a_frame_says_itself_that_its_lens_is_a_fisheye(tmp_path: Path) -> None:
    camera = "OPENCV_FISHEYE 64 48 60.0 62.0 30.5 25.0 0.02 0.0 0.0 0.0"
    root = write(write_capture(tmp_path / "bench", NAMES, camera), {**FLAT, "k1": 0.02})
    for index in range(len(NAMES)):
        change_frame(root, index, is_fisheye=True)
    assert_same_views(load(root), load(root, "colmap"))


def test_a_frame_s_own_intrinsics_win(root: Path) -> None:
    change_frame(root, 3, fl_x=45.0, cx=31.0)
    views = {view.name: view for view in load(root).train}
    np.testing.assert_allclose(views["003"].camera.intrinsics, [[45, 0, 31], [0, 62, 25], [0, 0, 1]])
    np.testing.assert_allclose(views["004"].camera.intrinsics, [[60, 0, 30.5], [0, 62, 25], [0, 0, 1]])


def test_names_without_extension_and_pictures_converted_since(root: Path) -> None:
    change_frame(root, 1, file_path="./images/001")
    (root / "images/002.png").rename(root / "images/002.JPG")
    assert_same_views(load(root), load(root, "colmap"))


def test_a_folder_of_reduced_copies(root: Path) -> None:
    (root / "images_2").mkdir()
    for name in NAMES:
        Image.fromarray(gradient(32, 24)).save(root / "images_2" / name)
    view = load(root, images="images_2").train[0]
    assert view.image.shape == (24, 32, 3)
    np.testing.assert_allclose(view.camera.intrinsics, [[30, 0, 15.25], [0, 31, 12.5], [0, 0, 1]], rtol=1e-6)


def test_points_come_from_the_file_s_cloud(root: Path) -> None:
    (root / "sparse_pc.ply").write_text(PLY)
    write(root, {**FLAT, "ply_file_path": "sparse_pc.ply", "applied_transform": [[1, 0, 0, 0]] * 3})
    scene = load(root)
    np.testing.assert_allclose(scene.points, [[0, 1, 2], [-1, 0.5, 0]])
    np.testing.assert_allclose(scene.point_colors, [[1, 0, 0.2], [0, 0, 0]], rtol=1e-6)


def test_random_points_fill_the_box_of_instant_ngp(root: Path) -> None:
    """There p·0.33 + 0.5 lies in a cube of edge aabb_scale around (0.5, 0.5, 0.5)."""
    inside = 0.33 * load(root).points + 0.5
    np.testing.assert_allclose([inside.min(), inside.max()], [0.5 - 2, 0.5 + 2], atol=0.01)
    write(root, {**FLAT, "scale": 1.0, "offset": [0.0, 0.5, 0.5], "aabb_scale": 1})
    points = load(root).points
    np.testing.assert_allclose(points.amin(dim=0), [0.0, -0.5, -0.5], atol=0.01)
    assert load(root, random_box=7.0, random_points=100).points.abs().max() > 6


def test_masks_of_the_frames(root: Path) -> None:
    (root / "m").mkdir()
    for index in range(len(NAMES)):
        mask = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
        mask[: index + 1] = 255
        Image.fromarray(mask).save(root / f"m/{index}.png")
        change_frame(root, index, mask_path=f"m/{index}.png")
    assert [int(view.masks["foreground"].sum()) for view in load(root).test] == [WIDTH, 9 * WIDTH]
    change_frame(root, 4, mask_path="")
    refused(root, r"transforms\.json: gives a mask_path for some frames only; add one for images/004\.png")
    change_frame(root, 4, mask_path="m/none.png")
    refused(root, r"names the mask .*m/none\.png, which is not there")


def test_what_frames_name_counts_before_the_masks_of_a_folder(root: Path) -> None:
    """One mask for all frames too, which lies in that folder."""
    (root / "masks").mkdir()
    inside = gradient()[..., 0] > 100
    Image.fromarray(np.where(inside, 255, 0).astype(np.uint8)).save(root / "masks/mask.png")
    for index in range(len(NAMES)):
        change_frame(root, index, mask_path="masks/mask.png")
    for view in load(root).train:
        np.testing.assert_array_equal(view.masks["foreground"], inside)


def test_masks_and_normals_beside_the_images(root: Path) -> None:
    for folder in ("masks", "normals"):
        (root / folder).mkdir()
        for name in NAMES:
            pixels = np.full((HEIGHT, WIDTH, 3), [128, 128, 0], dtype=np.uint8)
            pixels[:10] = 0 if folder == "masks" else pixels[:10]
            Image.fromarray(pixels).save(root / folder / name)
    view = load(root).train[0]
    assert view.masks["foreground"][10:].all()
    assert not view.masks["foreground"][:10].any()
    np.testing.assert_allclose(view.normal[20, 20], [0, 0, -1], atol=0.01)


@pytest.mark.parametrize(
    ("shared", "message"),
    [
        ({"cx": 30.5}, r"gives no focal length for 000\.png: neither fl_x, pixels, nor camera_angle_x, radians"),
        ({"fl_x": -3.0}, "focal length of -3 pixels in x"),
        ({"fl_x": "60"}, "fl_x='60', expected a finite number"),
        ({"fl_x": math.nan}, "fl_x=nan, expected a finite number"),
        (
            {**FLAT, "camera_model": "EQUIRECTANGULAR"},
            "camera_model='EQUIRECTANGULAR' is not supported; the models are",
        ),
        ({**FLAT, "k4": 0.1}, "k4=0.1 without a fisheye model is not supported"),
        ({**FLAT, "w": 48, "h": 64}, r"000\.png: is 64×48 pixels, its camera 48×64: not the same shape"),
        ({**FLAT, "aabb_scale": None}, r"no points .*ply_file_path.* no box .*aabb_scale.*dataset\.random_box"),
        ({**FLAT, "ply_file_path": "../points.ply"}, r"names a file outside its folder, '\.\./points\.ply'"),
        ({**FLAT, "ply_file_path": "points.ply"}, r"points\.ply: cannot be read as a point cloud"),
    ],
)
def test_files_that_cannot_be_used(root: Path, shared: dict[str, Any], message: str) -> None:
    refused(write(root, shared), message)


def test_mask_paths_and_settings_that_climb_out(root: Path) -> None:
    change_frame(root, 0, mask_path="../../mask.png")
    refused(root, "names a file outside its folder")
    refused(root, "names a file outside its folder", file="../transforms.json")


@pytest.mark.parametrize(
    ("ply", "message"),
    [
        (
            PLY.replace("vertex 2", "vertex 0").partition("end_header")[0] + "end_header\n",
            "holds no points to start from",
        ),
        (PLY.replace("0 1 2", "0 1 1e39"), "1 of 2 points lie at infinity"),
        (PLY.replace("0 1 2", "nan 1 2"), "1 of 2 points lie at infinity"),
        (PLY.replace("double z", "double depth"), "its vertices have x, y, depth, red"),
        ("solid stl", "cannot be read as a point cloud"),
    ],
)
def test_point_clouds_that_cannot_be_used(root: Path, ply: str, message: str) -> None:
    (root / "points.ply").write_text(ply)
    refused(write(root, {**FLAT, "ply_file_path": "points.ply"}), rf"points\.ply: {message}")


def test_a_frame_without_name_and_one_named_twice(root: Path) -> None:
    change_frame(root, 5, file_path="images/004.png")
    refused(root, r"004\.png: is listed 2 times, as 004\.png, 004\.png")
    change_frame(root, 5, file_path=None)
    refused(root, "frame 5 has no file_path")


def test_missing_images_are_refused_or_left_out(root: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name in NAMES[2:4]:
        (root / "images" / name).unlink()
    refused(
        root, r"2 of 10 images that it names are not there: images/002\.png, images/003\.png; .*dataset\.missing=skip"
    )
    assert len(load(root, missing="skip").train) == 7
    assert "2 of 10 images that it names are not there" in caplog.text
    for name in NAMES[:2] + NAMES[4:]:
        (root / "images" / name).unlink()
    refused(root, "10 of 10 images that it names are not there", missing="skip")


@needs_captures
def test_a_real_file_agrees_with_the_colmap_model_of_the_same_capture(tmp_path: Path) -> None:
    """The model was triangulated with the file's own poses; 17 of the file's 67 images do not exist."""
    root = Path(os.environ["ENVGS_BENCH_DATA"]) / "fox"
    if not root.is_dir():
        pytest.skip(f"{root} is not there")
    common = {"root": str(root), "downsample": 4}
    names = {"file": "transforms_original.json", "images": "images_original", "missing": "skip"}
    ours = load_scene({"kind": "transforms", **common, **names}, tmp_path)
    theirs = load_scene({"kind": "colmap", **common}, tmp_path)
    for a, b in zip([*ours.train, *ours.test], [*theirs.train, *theirs.test], strict=True):
        assert a.name == b.name
        np.testing.assert_allclose(a.camera.world_to_camera, b.camera.world_to_camera, atol=1e-4)
