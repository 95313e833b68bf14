"""Normals from files in the field's encodings and from estimators: always world frame, facing the camera."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from captures import HEIGHT, NAMES_OF_TEN, OPENCV, WIDTH, gradient, rotation_of, write_capture
from PIL import Image

from envgs_bench.core import Camera, Scene
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.sources import capture

NORMAL = np.array([0.48, -0.36, -0.8])  # world frame, facing cameras that look along +z
TO_OPENGL = np.diag([1.0, -1.0, -1.0])


def load(root: Path, **settings: Any) -> Scene:
    return load_scene({"kind": "colmap", "root": str(root), **settings}, root.parent / "cache")


def refused(root: Path, message: str, **settings: Any) -> None:
    with pytest.raises(DatasetError, match=message):
        load(root, **settings)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_capture(tmp_path / "bench", NAMES_OF_TEN)


def in_frame(index: int, frame: str) -> np.ndarray:
    in_camera = rotation_of(index) @ NORMAL
    return {"world": NORMAL, "camera": in_camera, "opengl": TO_OPENGL @ in_camera}[frame]


def write_pictures(root: Path, frame: str = "world", width: int = WIDTH, height: int = HEIGHT) -> None:
    """Every other map faces away, as some estimators leave them; the first rows hold none."""
    (root / "normals").mkdir()
    for index, name in enumerate(NAMES_OF_TEN):
        normal = in_frame(index, frame) * (-1) ** index
        coded = np.broadcast_to(np.round(255 * (normal / 2 + 0.5)), (height, width, 3)).astype(np.uint8).copy()
        coded[: height // 8] = (128, 0, 255)[index % 3]  # gray, black, white
        Image.fromarray(coded).save(root / "normals" / name)


def write_arrays(root: Path, frame: str = "world") -> None:
    (root / "normals").mkdir()
    for index, name in enumerate(NAMES_OF_TEN):
        normals = np.broadcast_to(in_frame(index, frame), (HEIGHT, WIDTH, 3)).astype(np.float32)
        normals[:6] = np.nan
        np.save(root / "normals" / f"{Path(name).stem}.npy", normals)


def assert_normals(scene: Scene, tolerance: float) -> None:
    for view in [*scene.train, *scene.test]:
        assert view.normal is not None
        height, width = view.image.shape[:2]
        assert view.normal.shape == (height, width, 3)
        unknown = height // 8
        assert (view.normal[:unknown] == 0).all()
        expected = np.broadcast_to(NORMAL, (height - unknown, width, 3))
        np.testing.assert_allclose(view.normal[unknown:], expected, atol=tolerance)


@pytest.mark.parametrize("frame", ["world", "camera", "opengl"])
def test_every_frame_becomes_the_world_s(root: Path, frame: str) -> None:
    write_pictures(root, frame)
    assert_normals(load(root, normals_frame=frame, exact_normals=True), 0.012)


@pytest.mark.parametrize("frame", ["world", "camera", "opengl"])
def test_float_arrays_keep_their_precision(root: Path, frame: str) -> None:
    write_arrays(root, frame)
    assert_normals(load(root, normals_frame=frame, exact_normals=True), 1e-6)


@pytest.mark.parametrize(("width", "height"), [(WIDTH // 2, HEIGHT // 2), (2 * WIDTH, 2 * HEIGHT)])
def test_another_resolution_is_resampled_and_the_log_says_so_each_time(
    root: Path, width: int, height: int, caplog: pytest.LogCaptureFixture
) -> None:
    write_pictures(root, width=width, height=height)
    for _ in range(2):
        caplog.clear()
        assert_normals(load(root, exact_normals=True), 0.012)
        assert "normals: resampled, being of another size than the images: 000.png, 001.png" in caplog.text


def test_a_guess_is_learned_from_and_never_scored_against(root: Path) -> None:
    write_arrays(root)
    scene = load(root)
    assert all(view.normal is not None for view in scene.train)
    assert all(view.normal is None for view in scene.test)


def test_resampling_averages_directions_and_normalizes(root: Path) -> None:
    (root / "normals").mkdir()
    for name in NAMES_OF_TEN:
        normals = np.zeros((HEIGHT, WIDTH, 3), dtype=np.float32)
        normals[:, ::2], normals[:, 1::2] = [0.6, 0, -0.8], [-0.6, 0, -0.8]
        np.save(root / "normals" / f"{Path(name).stem}.npy", normals)
    normal = load(root, downsample=2).train[0].normal
    np.testing.assert_allclose(normal, np.broadcast_to([0, 0, -1], normal.shape), atol=1e-6)


def test_normals_of_distorted_images_stay_with_their_pixels(tmp_path: Path) -> None:
    """Where the picture is red on the right, the normal leans right: its map has an edge there, and so has the red."""
    root = write_capture(tmp_path / "bench", NAMES_OF_TEN, OPENCV)
    (root / "normals").mkdir()
    right = gradient()[..., 0] >= 128
    for name in NAMES_OF_TEN:
        normals = np.where(right[..., None], [0.6, 0, -0.8], [-0.6, 0, -0.8]).astype(np.float32)
        np.save(root / "normals" / f"{Path(name).stem}.npy", normals)
    view = load(root).train[0]
    red = view.image[..., 0].int()
    sure = (red - 127.5).abs() > 5
    assert torch.equal((view.normal[..., 0] > 0)[sure], (red >= 128)[sure])
    np.testing.assert_allclose(view.normal.norm(dim=-1), 1, atol=1e-5)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((HEIGHT, WIDTH), dtype=np.float32), r"holds float32 \[48, 64\], expected floats \[H, W, 3\]"),
        (np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8), r"holds uint8 \[48, 64, 3\], expected floats"),
        (np.zeros((WIDTH, HEIGHT, 3)), r"is 48×64 pixels, its image 003\.png is 64×48: not the same shape"),
        (None, "cannot be read as an array"),
    ],
)
def test_arrays_that_cannot_be_used_are_named(root: Path, array: np.ndarray | None, message: str) -> None:
    write_arrays(root)
    path = root / "normals/003.npy"
    path.write_bytes(b"\x93NUMPY") if array is None else np.save(path, array)
    refused(root, rf"normals/003\.npy: {message}")


calls: list[str] = []


def leaning(image: np.ndarray, camera: Camera) -> np.ndarray:
    """An estimator for tests: the same normal everywhere, from the camera's pose, twice as long as it should be."""
    assert image.dtype == np.uint8
    calls.append(str(tuple(image.shape)))
    in_camera = camera.world_to_camera[:3, :3].double().numpy() @ NORMAL
    normals = np.broadcast_to(2 * in_camera, image.shape).copy()
    normals[: image.shape[0] // 8] = 0
    return normals


def of_another_shape(image: np.ndarray, camera: Camera) -> np.ndarray:
    return np.zeros((3, 3))


def failing(image: np.ndarray, camera: Camera) -> np.ndarray:
    raise RuntimeError("no weights")


def test_an_estimator_sees_the_training_views_once(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls.clear()
    scenes = [load(root, downsample=2, normal_estimator=f"{__name__}:leaning") for _ in range(2)]
    assert calls == ["(24, 32, 3)"] * 8
    for scene in scenes:
        assert all(view.normal is None for view in scene.test)
        for view in scene.train:
            assert (view.normal[:3] == 0).all()
            np.testing.assert_allclose(view.normal[3:], np.broadcast_to(NORMAL, (21, 32, 3)), atol=1e-6)
    monkeypatch.setattr(capture, "estimator_version", lambda path: "another")
    load(root, downsample=2, normal_estimator=f"{__name__}:leaning")
    assert len(calls) == 16  # its code has changed


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("nowhere:guess", "cannot be imported .*No module named 'nowhere'.*expected package.module:function"),
        ("os:guess", "cannot be imported"),
        ("os", "cannot be imported"),
        (".mine:guess", "cannot be imported"),
        (f"{__name__}:of_another_shape", r"returned float64 \[3, 3\] for image 001, expected floats \[48, 64, 3\]"),
        (f"{__name__}:failing", r"failed on image 001 \(RuntimeError\('no weights'\)\)"),
    ],
)
def test_estimators_that_cannot_be_used(root: Path, path: str, message: str) -> None:
    refused(root, rf"dataset\.normal_estimator='?{path}'?:? {message}", normal_estimator=path)


def test_a_preview_beside_an_array_is_ambiguous(root: Path) -> None:
    write_arrays(root)
    Image.fromarray(gradient()).save(root / "normals" / "003.png")
    with pytest.raises(
        DatasetError, match=r"normals: holds several files of one name.*: 003\.npy, 003\.png; move away"
    ):
        load(root)


def test_an_estimator_beside_a_folder_of_normals_is_ambiguous(root: Path) -> None:
    write_arrays(root)
    refused(root, "have normals already; drop the estimator, or move", normal_estimator=f"{__name__}:leaning")
