"""Bad captures: each a DatasetError that names the file or key."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from captures import PINHOLE, POINTS, gradient, write_capture
from PIL import Image

from envgs_bench.datasets import DatasetError, load_scene

NAMES = ["a.png", "b.png", "c.png", "d.png", "e.png", "f.png", "g.png"]


def refused(root: Path, message: str, **settings: Any) -> None:
    with pytest.raises(DatasetError, match=message):
        load_scene({"kind": "colmap", "root": str(root), **settings}, root.parent / "cache")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_capture(tmp_path / "bench", NAMES)


def replace_in(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_no_such_folder(tmp_path: Path) -> None:
    refused(tmp_path / "nowhere", re.escape(f"dataset.root={tmp_path / 'nowhere'}: there is no such folder"))


def test_no_images_folder(root: Path) -> None:
    refused(root, "bench: has no folder photos/; .*dataset.images", images="photos")


def test_no_model(root: Path) -> None:
    (root / "sparse").rename(root / "dense")
    refused(root, "no COLMAP model in sparse/0 or sparse .*dataset.model")
    refused(root, "no COLMAP model in mine ", model="mine")


def test_half_a_model(root: Path) -> None:
    (root / "sparse/0/images.txt").unlink()
    refused(root, "sparse/0: has no images.txt; export the model as a whole")


def test_a_model_without_a_file_of_points(root: Path) -> None:
    (root / "sparse/0/points3D.txt").unlink()
    refused(root, r"sparse/0: has cameras and images, and neither points3D.txt nor points3D.ply.*point_triangulator")


def test_a_truncated_binary_model(root: Path) -> None:
    (root / "cut").mkdir()
    pycolmap.Reconstruction(str(root / "sparse/0")).write_binary(str(root / "cut"))
    whole = (root / "cut/images.bin").read_bytes()
    (root / "cut/images.bin").write_bytes(whole[: len(whole) // 2])
    refused(root, "cut: cannot be read as a COLMAP model", model="cut")


def test_a_model_without_points(tmp_path: Path) -> None:
    refused(write_capture(tmp_path / "bench", NAMES, points=POINTS[:0]), "sparse/0: holds no points to start")


def test_one_missing_image(root: Path) -> None:
    (root / "images/c.png").unlink()
    refused(root, r"sparse/0: 1 of 7 images that it names are not there: c\.png; .*dataset\.missing=skip")


def test_all_images_missing(root: Path) -> None:
    for name in NAMES:
        (root / "images" / name).unlink()
    refused(root, r"sparse/0: 7 of 7 images .* are not there: a\.png, b\.png, c\.png, d\.png, e\.png …;")


def test_missing_images_may_be_left_out(root: Path, caplog: pytest.LogCaptureFixture) -> None:
    (root / "images/c.png").unlink()
    scene = load_scene({"kind": "colmap", "root": str(root), "missing": "skip"}, root.parent / "cache")
    assert [view.name for view in [*scene.test, *scene.train]] == ["a", "b", "d", "e", "f", "g"]
    assert "1 of 7 images that it names are not there: c.png; left out" in caplog.text


def test_images_without_a_pose_are_left_out_and_said_so(root: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name in ("x.png", "y.JPG"):
        Image.fromarray(gradient()).save(root / "images" / name)
    scene = load_scene({"kind": "colmap", "root": str(root)}, root.parent / "cache")
    assert len(scene.train) + len(scene.test) == 7
    assert "images: 2 images have no pose in the model and are left out: x.png, y.JPG" in caplog.text


@pytest.mark.parametrize("name", ["../secret.png", "/etc/secret.png", "left/../../secret.png"])
def test_names_that_climb_out_of_the_folder(root: Path, name: str) -> None:
    Image.fromarray(gradient()).save(root / "secret.png")
    replace_in(root / "sparse/0/images.txt", " c.png", f" {name}")
    refused(root, "sparse/0: names a file outside its folder, ")


def test_a_root_that_is_an_archive(tmp_path: Path) -> None:
    (tmp_path / "bench.zip").write_bytes(b"PK")
    refused(tmp_path / "bench.zip", r"bench\.zip: is a file; unpack it and give the folder")


def test_points_at_infinity(tmp_path: Path) -> None:
    """Beyond float32, which binary models can hold and text ones too."""
    far = POINTS.copy()
    far[[3, 8], 2] = 1e39
    refused(
        write_capture(tmp_path / "bench", NAMES, points=far), "sparse/0: 2 of 30 points lie at infinity .*remove them"
    )


def test_images_of_one_camera_and_two_sizes(root: Path) -> None:
    Image.fromarray(gradient(32, 24)).save(root / "images/d.png")
    refused(root, r"images of one camera have several sizes \(64×48: a\.png, .*; 32×24: d\.png\); make them one size")


def test_one_image_only(tmp_path: Path) -> None:
    refused(write_capture(tmp_path / "bench", NAMES[:1]), "bench/images: 1 image, expected at least two")


def test_images_of_one_name(tmp_path: Path) -> None:
    refused(
        write_capture(tmp_path / "bench", ["x/1.png", "x_1.png"]), r"several images are called x_1: x/1\.png, x_1\.png"
    )


def test_an_image_of_another_shape(root: Path) -> None:
    Image.fromarray(gradient(48, 64)).save(root / "images/d.png")
    refused(root, r"images/d\.png: is 48×64 pixels, its camera 64×48: not the same shape")


@pytest.mark.parametrize("value", ["nan", "-inf"])
def test_a_pose_that_is_not_finite_in_text(root: Path, value: str) -> None:
    lines = (root / "sparse/0/images.txt").read_text().splitlines()
    words = lines[3].split()
    lines[3] = " ".join([*words[:5], value, *words[6:]])
    (root / "sparse/0/images.txt").write_text("\n".join(lines) + "\n")
    refused(root, r"images\.txt:4: this line holds a number that is not finite")


def test_a_pose_that_is_not_finite_in_binary(root: Path) -> None:
    replace_in(root / "sparse/0/images.txt", "2 0.99", "2 0.99")  # image 2 is there
    (root / "broken").mkdir()
    model = pycolmap.Reconstruction(str(root / "sparse/0"))
    for frame in model.frames.values():
        if frame.has_pose and frame.frame_id == 2:
            frame.rig_from_world = pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([0.0, np.nan, 0.0]))
    model.write_binary(str(root / "broken"))
    refused(root, r"broken: the pose of image b\.png is not finite", model="broken")


def test_a_focal_length_that_is_not_positive(tmp_path: Path) -> None:
    refused(write_capture(tmp_path / "bench", NAMES, PINHOLE.replace("60.0", "-60.0")), r"a\.png: .*positive focal")


@pytest.mark.parametrize("spoil", [lambda data: data[: len(data) // 2], lambda _: b"", lambda _: b"not a picture"])
def test_a_corrupt_image(root: Path, spoil: Callable[[bytes], bytes]) -> None:
    path = root / "images/e.png"
    path.write_bytes(spoil(path.read_bytes()))
    refused(root, r"images/e\.png: cannot be decoded")


@pytest.mark.parametrize("folder", ["masks", "masks_glass", "normals"])
def test_masks_and_normals_of_a_wrong_size_or_missing(root: Path, folder: str) -> None:
    (root / folder).mkdir()
    for name in NAMES:
        Image.fromarray(gradient()).save(root / folder / name)
    Image.fromarray(gradient(24, 32)).save(root / folder / "b.png")
    refused(root, rf"{folder}/b\.png: is 24×32 pixels, its image b\.png is 64×48: not the same shape")
    (root / folder / "b.png").unlink()
    refused(root, rf"{folder}: holds no file for 1 of 7 images: b\.png;")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"downsample": 0}, "dataset.downsample=0"),
        ({"downsample": "half"}, "dataset.downsample='half'"),
        ({"normals_frame": "object"}, "dataset.normals_frame='object'"),
        ({"background": [0, 0]}, r"dataset.background"),
        ({"factor": 2}, "dataset.factor: there is no such key; the keys are .*downsample"),
    ],
)
def test_wrong_settings_are_named(root: Path, settings: dict[str, Any], message: str) -> None:
    refused(root, message, **settings)


def test_nothing_is_cached_of_a_capture_that_is_refused(root: Path) -> None:
    (root / "images/c.png").unlink()
    refused(root, "c.png")
    assert not list((root.parent / "cache").rglob("*.scene"))
