"""COLMAP models against themselves: synthetic ones of known cameras, spoiled in one way each."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from captures import NAMES_OF_TEN, OPENCV, write_capture
from hypothesis import given, settings
from hypothesis import strategies as st

from envgs_bench.core import Scene
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.consistency.tracks import check_tracks
from envgs_bench.datasets.consistency.twins import check_twins
from envgs_bench.datasets.notes import collecting

HERE = Path("model")


def synthetic(seed: int = 0, camera: str = "SIMPLE_RADIAL", noise: float = 0.5) -> pycolmap.Reconstruction:
    """Eight images of one camera that see a hundred points, by pycolmap's generator."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 8
    options.num_points3D, options.num_points2D_without_point3D = 100, 3
    options.camera_model_id = getattr(pycolmap.CameraModelId, camera)
    options.camera_params = {"SIMPLE_RADIAL": [1280, 512, 384, 0.05], "PINHOLE": [1280, 1270, 510, 390]}[camera]
    pycolmap.set_random_seed(seed)
    model = pycolmap.synthesize_dataset(options)
    rng = np.random.default_rng(seed)
    for image in model.images.values():
        for point in image.points2D:
            point.xy = point.xy + rng.normal(0, noise, 2)
    return model


def notes_of(model: pycolmap.Reconstruction) -> list[str]:
    with collecting() as notes:
        check_tracks(HERE, model)
    return notes


@pytest.mark.parametrize("camera", ["SIMPLE_RADIAL", "PINHOLE"])
@pytest.mark.parametrize("seed", range(3))
def test_what_belongs_together_passes_silently(seed: int, camera: str) -> None:
    assert notes_of(synthetic(seed, camera)) == []


def mirrored_points(model: pycolmap.Reconstruction) -> None:
    for point in model.points3D.values():
        point.xyz = point.xyz * [1, 1, -1]


def swapped_poses(model: pycolmap.Reconstruction) -> None:
    frames = list(model.frames.values())
    poses = [frame.rig_from_world for frame in frames]
    for frame, pose in zip(frames, [*poses[1:], poses[0]], strict=True):
        frame.rig_from_world = pose


def opengl_poses(model: pycolmap.Reconstruction) -> None:
    for frame in model.frames.values():
        pose = frame.rig_from_world.matrix()
        frame.rig_from_world = pycolmap.Rigid3d(np.diag([1.0, -1, -1]) @ pose)


def inverted_poses(model: pycolmap.Reconstruction) -> None:
    for frame in model.frames.values():
        frame.rig_from_world = frame.rig_from_world.inverse()


def halved_focal_length(model: pycolmap.Reconstruction) -> None:
    for camera in model.cameras.values():
        camera.params = [camera.params[0] / 2, *camera.params[1:]]


def other_world(model: pycolmap.Reconstruction) -> None:
    for point in model.points3D.values():
        point.xyz = 1.7 * point.xyz + [0.3, 0, 0]


@pytest.mark.parametrize(
    ("spoil", "what"),
    [
        (mirrored_points, "edge from where images show them"),
        (swapped_poses, "not of one model"),
        (opengl_poses, "behind their cameras"),
        (inverted_poses, "not of one model"),
        (halved_focal_length, "edge from where images show them"),
        (other_world, "edge from where images show them"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_what_does_not_belong_together_is_refused(spoil: Callable[[pycolmap.Reconstruction], None], what: str) -> None:
    model = synthetic()
    spoil(model)
    with pytest.raises(DatasetError, match=rf"^model: its points lie .*{what}"):
        check_tracks(HERE, model)


@settings(max_examples=25, deadline=None)
@given(
    axis=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1),
    angle=st.floats(np.radians(20), np.radians(340)),
    image=st.integers(0, 7),
)
def test_a_pose_that_is_not_its_image_s_is_noted(axis: tuple[float, ...], angle: float, image: int) -> None:
    """About its own center, by twenty degrees and more: 2 % of an edge are one."""
    model = synthetic()
    frame = list(model.frames.values())[image]
    turn = pycolmap.Rotation3d(angle * np.asarray(axis) / np.linalg.norm(axis))
    frame.rig_from_world = pycolmap.Rigid3d(turn, np.zeros(3)) * frame.rig_from_world
    name = next(i.name for i in model.images.values() if i.frame_id == frame.frame_id)
    (text,) = notes_of(model)
    assert (
        f"1 of 8 images show points more than 2 % of an edge from where their poses see them (median): {name}" in text
    )


def test_a_size_of_other_pictures_than_the_focal_length_is_refused() -> None:
    model = synthetic()
    for camera in model.cameras.values():
        camera.width, camera.height = camera.width // 2, camera.height // 2
    with pytest.raises(DatasetError, match=r"beside the pictures: width and height in cameras"):
        check_tracks(HERE, model)


def test_cameras_scaled_alone_are_noted() -> None:
    model = synthetic()
    for camera in model.cameras.values():
        camera.rescale(0.25)
    (text,) = notes_of(model)
    assert "show points 4 times as far out as its cameras see them" in text


def test_noise_of_some_pixels_is_noted() -> None:
    (text,) = notes_of(synthetic(noise=8.0))
    assert "Adjust the bundle again" in text


def test_models_without_observations_pass_silently() -> None:
    model = synthetic()
    for key in list(model.points3D):
        model.delete_point3D(key)
    assert notes_of(model) == []


@pytest.fixture
def seen(tmp_path: Path) -> Path:
    """A capture whose images show its points."""
    places = np.random.default_rng(0).uniform(5, 45, (40, 2))
    return write_capture(tmp_path / "seen", NAMES_OF_TEN, seen_at=places)


def keep_points(root: Path, kept: slice, shift: float = 0) -> None:
    """Leave these lines of points3D.txt, moved along x; images.txt still names the others."""
    path = root / "sparse/0/points3D.txt"
    header, *rows = path.read_text().splitlines()
    words = [row.split() for row in rows[kept]]
    path.write_text("\n".join([header, *(" ".join([w[0], str(float(w[1]) + shift), *w[2:]]) for w in words)]) + "\n")


def test_a_thinned_cloud_is_read_and_checked_by_what_is_left(seen: Path) -> None:
    keep_points(seen, slice(None, None, 2))
    with collecting() as notes:
        assert len(load(seen).points) == 20
    assert not any("show points" in note for note in notes)
    keep_points(seen, slice(None), shift=100)
    with pytest.raises(DatasetError, match=r"sparse/0: its points lie .*not of one model"):
        load(seen)


@pytest.mark.parametrize("binary", [False, True])
def test_points_that_images_show_and_that_are_all_gone_are_named(seen: Path, binary: bool) -> None:
    model = seen / "sparse/0"
    if binary:
        pycolmap.Reconstruction(str(model)).write_binary(str(model))
        for path in model.glob("*.txt"):
            path.unlink()
        (model / "points3D.bin").write_bytes(bytes(8))
    else:
        keep_points(seen, slice(0))
    with pytest.raises(DatasetError, match=r"sparse/0: holds no points to start"):
        load(seen)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A capture whose model lies there as text and as binary files."""
    root = write_capture(tmp_path / "bench", NAMES_OF_TEN, OPENCV)
    pycolmap.Reconstruction(str(root / "sparse/0")).write_binary(str(root / "sparse/0"))
    return root


def load(root: Path) -> Scene:
    return load_scene({"kind": "colmap", "root": str(root)}, root.parent / "cache")


def change(root: Path, file: str, old: str, new: str) -> None:
    text = (root / "sparse/0" / file).read_text()
    assert old in text
    (root / "sparse/0" / file).write_text(text.replace(old, new, 1))


def test_text_beside_binary_files_that_says_the_same_passes(root: Path) -> None:
    with collecting() as notes:
        load(root)
    assert not any("state different things" in note for note in notes)


@pytest.mark.parametrize(
    ("file", "old", "new", "what"),
    [
        ("cameras.txt", "60.0", "61.0", "cameras.txt and cameras.bin state different things of camera 1"),
        ("cameras.txt", "\n1 ", "\n2 ", "which cameras there are"),
        ("cameras.txt", "60.0", "x", "cannot be read beside cameras.bin"),
        ("images.txt", "003.png", "other.png", "which images there are"),
        ("images.txt", "-0.1 ", "-0.2 ", "images.txt and images.bin state different things of the pose of 001.png"),
    ],
)
def test_text_beside_binary_files_that_says_another_thing(root: Path, file: str, old: str, new: str, what: str) -> None:
    if file == "images.txt" and old == "-0.1 ":
        line = next(line for line in (root / "sparse/0/images.txt").read_text().splitlines() if "001.png" in line)
        words = line.split()
        old, new = line, " ".join([*words[:5], "0.5", *words[6:]])
    change(root, file, old, new)
    with pytest.raises(DatasetError, match=what):
        load(root)


def test_text_counts_where_a_binary_file_is_missing(root: Path) -> None:
    (root / "sparse/0/points3D.bin").unlink()
    change(root, "cameras.txt", "60.0", "61.0")
    view = load(root).train[0]
    shutil.rmtree(root / "sparse/0")
    assert float(view.camera.intrinsics[0, 0]) == pytest.approx(61.0)


def test_twins_of_random_models_agree(tmp_path: Path) -> None:
    model = synthetic(5)
    model.write_text(str(tmp_path))
    model.write_binary(str(tmp_path))
    check_twins(tmp_path, pycolmap.Reconstruction(str(tmp_path)))
