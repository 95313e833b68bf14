"""Photographs without cameras: structure from motion on pictures that the tests render, and on real ones."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
import torch
from corner_photographs import FOCAL, HEIGHT, WIDTH, look, photograph
from PIL import Image

from envgs_bench.core import Scene
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.photographs.reconstruction import Reconstructor
from envgs_bench.datasets.progress import listening

VIEWS = 8


def load(root: Path, **settings: Any) -> Scene:
    common = {"kind": "photos", "root": str(root), "camera_model": "SIMPLE_PINHOLE", "feature_size": 240}
    return load_scene({**common, **settings}, root.parent / "cache")


@pytest.fixture(scope="module")
def corner(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs with names that a list of pairs would break at, and masks beside them."""
    root = tmp_path_factory.mktemp("photos") / "a corner"
    (root / "masks").mkdir(parents=True)
    for index in range(VIEWS):
        Image.fromarray(photograph(index)).save(root / f"photo no {index}.png")
        Image.fromarray(np.full((HEIGHT, WIDTH), 255, dtype=np.uint8)).save(root / f"masks/photo no {index}.png")
    return root


def test_cameras_are_where_the_photographs_were_taken(corner: Path, caplog: pytest.LogCaptureFixture) -> None:
    stages: dict[str, tuple[int, int]] = {}
    with listening(lambda stage, done, total: stages.__setitem__(stage, (done, total))):
        scene = load(corner)
    assert f"placed {VIEWS} of {VIEWS} images" in caplog.text
    assert stages["finding features"] == stages["placing images"] == stages["reading images"] == (VIEWS, VIEWS)
    assert stages["matching images"] == (28, 28)
    views = sorted([*scene.train, *scene.test], key=lambda view: view.name)
    assert [view.name for view in views] == [f"photo no {index}" for index in range(VIEWS)]
    assert all(view.masks["foreground"].all() for view in views)
    assert len(scene.points) > 200
    np.testing.assert_allclose(views[0].camera.intrinsics[0, 0], FOCAL, rtol=0.03)
    found = np.stack([view.camera.center.numpy() for view in views])
    true = np.stack([look(index)[1] for index in range(VIEWS)])
    assert distance_after_alignment(found, true) < 0.02
    for a, b in ((0, 3), (2, 7)):
        turn = views[a].camera.world_to_camera[:3, :3] @ views[b].camera.world_to_camera[:3, :3].T
        np.testing.assert_allclose(turn, look(a)[0] @ look(b)[0].T, atol=0.01)


def distance_after_alignment(found: np.ndarray, true: np.ndarray) -> float:
    """The largest distance left once `found` is turned, scaled and moved onto `true` (Umeyama's closed form)."""
    a, b = found - found.mean(0), true - true.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = (s * np.diag(sign)).sum() / (a**2).sum()
    return float(np.linalg.norm(scale * a @ (u @ sign @ vt).T - b, axis=1).max())


def test_the_model_is_made_once(corner: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = load(corner)
    monkeypatch.setattr(Reconstructor, "_map", lambda *_: pytest.fail("mapped again"))
    second = load(corner, downsample=2)
    assert torch.equal(first.points, second.points)
    assert second.train[0].image.shape == (HEIGHT // 2, WIDTH // 2, 3)


def test_a_model_that_the_disk_changed_is_made_again(corner: Path) -> None:
    load(corner)
    (model,) = (corner.parent / "cache/models").iterdir()
    content = bytearray((model / "points3D.bin").read_bytes())
    content[30] ^= 64  # of the first point's place
    (model / "points3D.bin").write_bytes(content)
    with pytest.warns(UserWarning, match="is damaged: it is not what was written; it is made again"):
        again = load(corner, name="another scene, of the same model")
    assert len(again.points) > 200
    assert (model / "points3D.bin").read_bytes() != bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load(corner, name="a third scene of it")


def test_where_a_model_cannot_be_kept_it_is_said_before_it_is_made(corner: Path, tmp_path: Path) -> None:
    """Of photographs whose scene is in nobody's cache: minutes of work, which would be lost."""
    (tmp_path / "file").touch()
    with pytest.raises(
        DatasetError, match=r"file/models: cannot be written .*and the model of these photographs"
    ) as at:
        load_scene({"kind": "photos", "root": str(corner)}, tmp_path / "file")
    assert "Give a folder that can be written as cache_dir=, or set ENVGS_BENCH_CACHE to one" in str(at.value)


def test_too_few_images_that_can_be_placed(tmp_path: Path) -> None:
    """Half of the photographs show something else altogether."""
    root = tmp_path / "mixed"
    (root / "images").mkdir(parents=True)
    for index in range(4):
        Image.fromarray(photograph(index)).save(root / f"images/{index}.png")
        noise = np.random.default_rng(index).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        Image.fromarray(noise).save(root / f"images/{index + 4}.png")
    with pytest.raises(
        DatasetError, match=r"images: structure from motion placed 4 of 8 images, fewer than .*0\.6 .*4\.png"
    ):
        load(root, min_registered=0.6)
    assert len(load(root, min_registered=0.5).train) == 3


def test_photographs_without_features(tmp_path: Path) -> None:
    (tmp_path / "gray").mkdir()
    for index in range(3):
        Image.fromarray(np.full((HEIGHT, WIDTH, 3), 90, dtype=np.uint8)).save(tmp_path / f"gray/{index}.png")
    with pytest.raises(DatasetError, match="gray: structure from motion placed none of 3 images"):
        load(tmp_path / "gray")
    assert not list((tmp_path / "cache").rglob("*.part"))


def test_folders_that_hold_too_little(tmp_path: Path) -> None:
    (tmp_path / "few").mkdir()
    Image.fromarray(photograph(0)).save(tmp_path / "few/a.png")
    (tmp_path / "few/b.heic").touch()
    with pytest.raises(DatasetError, match=r"few: holds 1 images, expected 3 at least.*known are \.png, \.jpg"):
        load(tmp_path / "few")
    with pytest.raises(DatasetError, match=r"few: has no folder jpgs/; .*dataset\.images"):
        load(tmp_path / "few", images="jpgs")
    for name in ("b.jpg", "c.TIF"):
        (tmp_path / "few" / name).write_bytes(b"\xff\xd8")
    with pytest.raises(DatasetError, match=r"few/b\.jpg: cannot be decoded"):
        load(tmp_path / "few")


@pytest.mark.slow
def test_a_real_capture_is_placed_as_its_own_model_says(tmp_path: Path) -> None:
    if "ENVGS_BENCH_DATA" not in os.environ:
        pytest.skip("ENVGS_BENCH_DATA names no folder of real captures")
    source = Path(os.environ["ENVGS_BENCH_DATA"]) / "lund_door"
    if not source.is_dir():
        pytest.skip(f"{source} is not there")
    (tmp_path / "door").symlink_to(source / "images")
    scene = load(tmp_path / "door", camera_model="OPENCV", feature_size=484)
    model = pycolmap.Reconstruction(str(source / "sparse/0"))
    poses = {Path(image.name).stem: image for image in model.images.values()}
    views = [*scene.train, *scene.test]
    assert len(views) == 12
    found = np.stack([view.camera.center.numpy() for view in views])
    true = np.stack([poses[view.name].projection_center() for view in views])
    assert distance_after_alignment(found, true) < 0.01 * np.linalg.norm(true - true.mean(0), axis=1).mean()
