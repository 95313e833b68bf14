"""Camera paths: against their definitions, and against what another writer of transforms.json says."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from toy_scenes import camera_at

from envgs_bench.core import Camera, Placement
from envgs_bench.datasets import DatasetError
from envgs_bench.datasets.export.blender import write_blender
from envgs_bench.testing import tiny_scene
from envgs_bench.viewing.camera_paths import interpolate, orbit, reframed, spiral, up_direction
from envgs_bench.viewing.path_file import read_path
from envgs_bench.viewing.path_writing import FORMATS, write_path

TARGET = (1.0, -2.0, 0.5)


def ring(count: int = 7, radius: float = 3.0, height: float = 1.5) -> list[Camera]:
    """Upright cameras (world z) around TARGET."""
    angles = [0.3 + 2 * math.pi * i / count for i in range(count)]
    x, y, z = TARGET
    return [camera_at((x + radius * math.cos(a), y + radius * math.sin(a), z + height), TARGET) for a in angles]


def assert_same(ours: Camera, theirs: Camera) -> None:
    assert torch.allclose(ours.world_to_camera, theirs.world_to_camera, atol=2e-5)
    assert torch.allclose(ours.intrinsics, theirs.intrinsics, rtol=1e-6)
    assert (ours.width, ours.height) == (theirs.width, theirs.height)


def test_an_orbit_of_cameras_on_a_circle_is_that_circle() -> None:
    cameras = ring()
    for ours, theirs in zip(orbit(cameras, 7), cameras, strict=True):
        assert_same(ours, theirs)


def test_a_spiral_looks_at_what_the_cameras_look_at_from_around_the_first() -> None:
    cameras = ring()
    distance = math.hypot(3.0, 1.5)
    path = spiral(cameras, 80)
    target = torch.tensor(TARGET)
    offsets = torch.stack([camera.center for camera in path]) - cameras[0].center
    inside = (offsets @ cameras[0].world_to_camera[:3, :3].T).numpy() / distance
    assert np.allclose(np.hypot(inside[:, 0], inside[:, 1]), 0.15, atol=1e-5)
    assert np.allclose([inside[:, 2].min(), inside[:, 2].max()], [-0.15, 0.15], atol=1e-5)
    for camera in path:
        assert torch.allclose(camera.project(target)[0], camera.intrinsics[:2, 2], atol=1e-3)
        assert camera.world_to_camera[1, 2] < 0  # upright


def test_a_spiral_of_cameras_that_look_outward_looks_outward() -> None:
    outward = [camera_at((math.cos(a), math.sin(a), 0), (9 * math.cos(a), 9 * math.sin(a), 0)) for a in (0, 2, 4)]
    for camera in spiral(outward, 5):
        assert camera.world_to_camera[2, 0] > 0.9  # as the first, along x


def test_interpolation_goes_through_every_camera() -> None:
    cameras = ring(4)
    path = interpolate(cameras, 31)
    for ours, theirs in zip(path[::10], cameras, strict=True):
        assert_same(ours, theirs)
    steps = torch.stack([b.center - a.center for a, b in pairwise(path)]).norm(dim=1)
    assert steps.max() < 2.5 * steps.min()
    with pytest.raises(ValueError, match="needs two at least, not 1; try orbit"):
        interpolate(cameras[:1], 5)


def test_up_is_the_cameras_own_and_z_where_they_disagree() -> None:
    assert np.allclose(up_direction(ring()), [0, 0, 1], atol=1e-6)
    turned = torch.tensor([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # world (x, y, z) -> (x, −z, y)
    cameras = [Camera(c.world_to_camera @ turned.T, c.intrinsics, c.width, c.height) for c in ring()]
    assert np.allclose(up_direction(cameras), [0, -1, 0], atol=1e-6)
    upside_down = torch.diag(torch.tensor([-1.0, -1, 1, 1])) @ ring()[0].world_to_camera
    assert np.allclose(
        up_direction([ring()[0], Camera(upside_down, ring()[0].intrinsics, 40, 40)]), [0, 0, 1], atol=1e-6
    )


def test_a_camera_of_another_size_sees_the_same_from_top_to_bottom() -> None:
    camera = camera_at((3.0, 0, 0))
    wide = reframed(camera, 160, 80)
    point = torch.tensor([0.0, 0.4, 0.3])
    x, y = camera.project(point)[0].tolist()
    assert torch.allclose(wide.project(point)[0], torch.tensor([2 * x + 40, 2 * y]), atol=1e-3)
    assert (wide.width, wide.height) == (160, 80)


def test_the_frames_of_a_transforms_json_are_cameras(tmp_path: Path) -> None:
    scene = tiny_scene()
    write_blender(scene, tmp_path / "written")
    read = read_path(tmp_path / "written" / "transforms_train.json", scene.test[0].camera, Placement())
    for ours, view in zip(read, scene.train, strict=True):
        assert_same(ours, view.camera)


def test_a_path_in_the_coordinates_of_data_far_away_and_small_is_in_the_scenes_world(tmp_path: Path) -> None:
    placement = Placement((500123.0, 5600456.0, 312.0), 1 / 128)
    scene = replace(tiny_scene(), placement=placement)
    write_blender(scene, tmp_path / "written")
    read = read_path(tmp_path / "written" / "transforms_train.json", scene.test[0].camera, placement)
    for ours, view in zip(read, scene.train, strict=True):
        assert_same(ours, view.camera)


def test_a_path_of_nerfstudios_is_read(tmp_path: Path) -> None:
    """A camera at (0, 0, 5) that looks along −z, as OpenGL's do unturned; 90° from top to bottom."""
    matrix = np.eye(4)
    matrix[2, 3] = 5
    content = {
        "camera_path": [{"camera_to_world": matrix.reshape(-1).tolist(), "fov": 90, "aspect": 2}],
        **{"render_width": 200, "render_height": 100, "fps": 24, "seconds": 1},
    }
    (tmp_path / "path.json").write_text(json.dumps(content))
    (camera,) = read_path(tmp_path / "path.json", ring()[0], Placement())
    assert camera.intrinsics.tolist() == [[pytest.approx(50), 0, 100], [0, pytest.approx(50), 50], [0, 0, 1]]
    right_and_up = camera.project(torch.tensor([1.0, 1, 0]))
    assert right_and_up[0].tolist() == pytest.approx([110, 40], abs=1e-3)
    assert float(right_and_up[1]) == pytest.approx(5)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "cannot be read as JSON"),
        ("[]", "holds no camera path; expected"),
        ('{"camera_path": []}', "holds no camera path; expected"),
        ('{"camera_path": [{"fov": 60}]}', "frame 0 is no camera"),
        ('{"camera_path": [{"camera_to_world": [1, 2], "fov": 60}]}', "frame 0 is no camera"),
        ('{"frames": [{"file_path": "a"}]}', "transform_matrix of frame 0 is no camera-to-world matrix"),
        (
            '{"frames": [{"transform_matrix": [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}',
            "transform_matrix of frame 0 is no rotation",
        ),
        (
            '{"camera_type": "equirectangular", "camera_path": [{"camera_to_world": [], "fov": 60}]}',
            "camera_type='equirectangular', of which no picture can be drawn",
        ),
        ('{"camera_path": [{"camera_type": "fisheye"}]}', "camera_type='fisheye'"),
        ('{"camera_model": "OPENCV_FISHEYE", "frames": [{}]}', "frame 0 has a fisheye camera"),
        ('{"camera_model": "EQUIRECTANGULAR", "frames": [{}]}', "camera_model='EQUIRECTANGULAR' is not supported"),
        ('{"w": 99999, "frames": [{"transform_matrix": []}]}', "w=99999, expected a number from 1 to 16,384"),
    ],
)
def test_files_that_hold_no_path_are_named(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "path.json").write_text(content)
    with pytest.raises(DatasetError, match=r"path\.json: ") as caught:
        read_path(tmp_path / "path.json", ring()[0], Placement())
    assert message in str(caught.value)


PLACED = Placement((10.0, -20.0, 5.0), 4.0)


@pytest.mark.parametrize("form", FORMATS)
def test_what_is_written_for_another_program_is_read_back(tmp_path: Path, form: str) -> None:
    cameras = ring()
    path = tmp_path / f"path{FORMATS[form][0]}"
    write_path(path, cameras, PLACED, form)
    found = read_path(path, cameras[0], PLACED)
    assert len(found) == len(cameras)
    for ours, theirs in zip(cameras, found, strict=True):
        assert torch.allclose(ours.world_to_camera, theirs.world_to_camera, atol=2e-5)
        assert float(theirs.intrinsics[1, 1]) == pytest.approx(float(ours.intrinsics[1, 1]), rel=1e-5)
        if form == "transforms":
            assert_same(ours, theirs)


def test_every_format_says_where_the_camera_stands_and_looks_in_its_own_axes(tmp_path: Path) -> None:
    """A camera at (1, 2, 3) of the data that looks along +x, upright in z."""
    camera = camera_at((1.0, 2.0, 3.0), (5.0, 2.0, 3.0))
    for form, (suffix, _) in FORMATS.items():
        write_path(tmp_path / f"{form}{suffix}", [camera], Placement(), form, fps=24)
    (frame,) = json.loads((tmp_path / "transforms.json").read_text())["frames"]
    matrix = np.array(frame["transform_matrix"])
    nerfstudio = json.loads((tmp_path / "nerfstudio.json").read_text())
    assert np.allclose(nerfstudio["camera_path"][0]["camera_to_world"], matrix.reshape(-1))
    fov = math.radians(nerfstudio["camera_path"][0]["fov"])
    assert math.tan(fov / 2) == pytest.approx(camera.height / 2 / float(camera.intrinsics[1, 1]))
    assert (nerfstudio["fps"], nerfstudio["seconds"]) == (24, 1 / 24)
    (entry,) = json.loads((tmp_path / "supersplat.json").read_text())
    numbers = [float(word) for word in (tmp_path / "blender.chan").read_text().split()]
    for place in (matrix[:3, 3], entry["position"], numbers[1:4]):
        assert np.allclose(place, (1, 2, 3), atol=1e-6)
    assert np.allclose(-matrix[:3, 2], (1, 0, 0), atol=1e-6)  # OpenGL's cameras look along −z
    assert np.allclose(np.array(entry["rotation"])[:, 2], (1, 0, 0), atol=1e-6)  # 3DGS's along z
    x, y, z = np.radians(numbers[4:7])  # Blender's XYZ: about x first, then y, then z
    turns = [
        np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]]),
        np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]]),
        np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]]),
    ]
    assert np.allclose(turns[2] @ turns[1] @ turns[0], matrix[:3, :3], atol=1e-6)


def test_a_wrong_name_or_format_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"as blender is a file that ends in \.chan"):
        write_path(tmp_path / "a.json", ring(), Placement(), "blender")
    with pytest.raises(ValueError, match="expected one of transforms, nerfstudio, supersplat, blender"):
        write_path(tmp_path / "a.json", ring(), Placement(), "maya")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.chan", "1 0 0 0 0 0", "line 1 is no camera"),
        ("a.chan", "1 0 0 0 a 0 0 50", "line 1 is no camera"),
        ("a.chan", "# nothing", "holds no camera path"),
        ("a.json", '[{"position": [1, 2], "rotation": []}]', "frame 0 is no camera of a cameras.json"),
        ("a.json", '[{"position": [1, 2, 3], "rotation": [[2,0,0],[0,1,0],[0,0,1]], "fx": 1}]', "frame 0"),
    ],
)
def test_files_of_other_programs_that_hold_no_cameras_are_named(
    tmp_path: Path, name: str, content: str, message: str
) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(DatasetError, match=message):
        read_path(tmp_path / name, ring()[0], Placement())
