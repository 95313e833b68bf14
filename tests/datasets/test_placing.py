"""Worlds far from their origin, or of no usual size: what is loaded shows what the data mean, and exports give it back.

The truth is a ring of cameras around points, put anywhere and made any size in float64; files are written by pycolmap
and json.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pycolmap
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image
from plyfile import PlyData, PlyElement
from scipy.spatial.transform import Rotation

from envgs_bench.core import Camera, Placement, Scene, View
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.export import export_scene
from envgs_bench.datasets.notes import collecting
from envgs_bench.datasets.store.cache import cached_scene

Array = NDArray[np.float64]

WIDTH, HEIGHT = 32, 24
UTM = (500123.4, 5600456.1, 312.7)
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
LENSES = {
    "SIMPLE_PINHOLE": lambda f: [f, 16, 12],
    "PINHOLE": lambda f: [f, 1.02 * f, 15.5, 12.5],
    "SIMPLE_RADIAL": lambda f: [f, 16, 12, 0.02],
    "OPENCV": lambda f: [f, f, 15.5, 12, 0.02, -0.01, 0.001, -0.001],
    "OPENCV_FISHEYE": lambda f: [f, f, 16, 12, 0.01, 0.0, 0.0, 0.0],
}


@dataclass(frozen=True)
class World:
    """The truth: of its coordinates p, the data's are shift + size · p."""

    shift: Array
    size: float
    seed: int
    lens: str = "PINHOLE"

    @property
    def camera(self) -> pycolmap.Camera:
        focal = float(np.random.default_rng(self.seed).uniform(25, 60))
        return pycolmap.Camera(model=self.lens, width=WIDTH, height=HEIGHT, params=LENSES[self.lens](focal))

    @property
    def centers(self) -> Array:
        angles = np.linspace(0, 2 * np.pi, 5, endpoint=False)
        return np.stack([3 * np.cos(angles), 3 * np.sin(angles), 1 + 0.3 * np.sin(3 * angles)], axis=1)

    @property
    def rotations(self) -> Array:
        """World to camera [5, 3, 3]: toward the middle, with a roll."""
        z = -self.centers / np.linalg.norm(self.centers, axis=1, keepdims=True)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        looking = np.stack([x, np.cross(z, x), z], axis=1)
        rolls = np.random.default_rng(self.seed).uniform(-1, 1, (5, 1)) * [0, 0, 1]
        return Rotation.from_rotvec(rolls).as_matrix() @ looking

    @property
    def points(self) -> Array:
        return np.random.default_rng(self.seed).uniform(-0.7, 0.7, (60, 3))

    def of_data(self, places: Array) -> Array:
        return self.shift + self.size * places

    def poses(self) -> Array:
        """World to camera [5, 4, 4], of the data."""
        poses = np.tile(np.eye(4), (5, 1, 1))
        poses[:, :3, :3] = self.rotations
        poses[:, :3, 3] = -np.einsum("vij,vj->vi", self.rotations, self.of_data(self.centers))
        return poses

    def assert_shown(self, scene: Scene) -> None:
        """Every camera projects every point of the data to within a tenth of a pixel of where it is seen."""
        assert len(scene.points) == len(self.points)
        for view in [*scene.train, *scene.test]:
            index, camera = int(view.name[-1]), view.camera
            seen = (self.points - self.centers[index]) @ self.rotations[index].T @ camera.intrinsics.double().numpy().T
            pixels, depths = camera.project(scene.points)
            assert np.abs(pixels.numpy() - seen[:, :2] / seen[:, 2:]).max() < 0.1
            assert (depths > 0.2).float().mean() > 0.95  # methods draw nothing nearer
            assert depths.max() < 1e4


worlds = st.builds(
    lambda way, far, size, seed, lens: World(
        10**far * Rotation.random(random_state=way).as_matrix()[0], 10**size, seed, lens
    ),
    st.integers(0, 99),
    st.floats(0, 7),
    st.floats(-4, 4),
    st.integers(0, 99),
    st.sampled_from(list(LENSES)),
)
few = settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck))


def write_pictures(root: Path, names: list[str]) -> None:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (WIDTH, HEIGHT), (90, 120, 30)).save(root / name)


def write_colmap(world: World, root: Path, text: bool) -> dict[str, Any]:
    names = [f"{index}.png" for index in range(5)]
    write_pictures(root / "images", names)
    model = pycolmap.Reconstruction()
    camera = world.camera
    camera.camera_id = 1
    model.add_camera_with_trivial_rig(camera)
    for number, (name, pose) in enumerate(zip(names, world.poses(), strict=True), start=1):
        image = pycolmap.Image(name=name, camera_id=1, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    for point in world.of_data(world.points):
        model.add_point3D(point, pycolmap.Track(), np.array([10, 20, 30], np.uint8))
    (root / "sparse/0").mkdir(parents=True)
    (model.write_text if text else model.write_binary)(str(root / "sparse/0"))
    return {"kind": "colmap", "root": str(root)}


def write_points(world: World, path: Path, dtype: str = "f8") -> None:
    rows = np.empty(
        len(world.points), [*((axis, dtype) for axis in "xyz"), *((c, "u1") for c in ("red", "green", "blue"))]
    )
    for axis, values in zip("xyz", world.of_data(world.points).T, strict=True):
        rows[axis] = values
    for channel in ("red", "green", "blue"):
        rows[channel] = 99
    path.parent.mkdir(parents=True, exist_ok=True)
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(path))


def frames_of(world: World, names: list[str]) -> list[dict[str, Any]]:
    to_world = np.linalg.inv(world.poses())
    to_world[:, :3, 3] = world.of_data(world.centers)
    return [{"file_path": n, "transform_matrix": (m @ OPENGL).tolist()} for n, m in zip(names, to_world, strict=True)]


def intrinsics_of(world: World) -> dict[str, Any]:
    fx, fy, cx, cy = (float(v) for v in np.array(world.camera.calibration_matrix())[[0, 1, 0, 1], [0, 1, 2, 2]])
    stated = {"w": WIDTH, "h": HEIGHT, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy}
    if world.lens in ("OPENCV", "OPENCV_FISHEYE"):
        keys = ("k1", "k2", "p1", "p2") if world.lens == "OPENCV" else ("k1", "k2", "k3", "k4")
        stated |= {"camera_model": world.lens, **dict(zip(keys, map(float, world.camera.params[4:]), strict=True))}
    return stated


def write_transforms(world: World, root: Path) -> dict[str, Any]:
    names = [f"images/{index}.png" for index in range(5)]
    write_pictures(root, names)
    write_points(world, root / "points.ply")
    content = {**intrinsics_of(world), "ply_file_path": "points.ply", "frames": frames_of(world, names)}
    (root / "transforms.json").write_text(json.dumps(content))
    return {"kind": "transforms", "root": str(root)}


def write_blender(world: World, root: Path, points: str | None = "f8") -> dict[str, Any]:
    names = [f"{'train' if index else 'test'}/{index}" for index in range(5)]
    write_pictures(root, [f"{name}.png" for name in names])
    frames = frames_of(world, names)
    for split, part in (("test", frames[:1]), ("train", frames[1:])):
        (root / f"transforms_{split}.json").write_text(json.dumps({**intrinsics_of(world), "frames": part}))
    if points:
        write_points(world, root / "points3d.ply", points)
    return {"kind": "blender", "root": str(root)}


WRITERS = {
    "colmap-text": lambda world, root: write_colmap(world, root, text=True),
    "colmap": lambda world, root: write_colmap(world, root, text=False),
    "transforms": write_transforms,
    "blender": write_blender,
}


@pytest.mark.parametrize("form", WRITERS)
@few
@given(world=worlds)
def test_data_anywhere_and_of_any_size_are_shown_where_they_are(form: str, world: World) -> None:
    """Read, written as each format, and read again."""
    with TemporaryDirectory() as folder:
        scene = load_scene(WRITERS[form](world, Path(folder, "data")), Path(folder, "cache"))
        world.assert_shown(scene)
        written = export_scene(scene, Path(folder, "written"), "blender" if form == "blender" else "colmap-text")
        world.assert_shown(load_scene(written, Path(folder, "cache")))
        if form == "colmap":
            assert_in_data(world, Path(folder, "written/sparse/0"))


def assert_in_data(world: World, model: Path) -> None:
    """The export's cameras and points are the data's, as pycolmap reads them."""
    read = pycolmap.Reconstruction(str(model))
    accuracy = 1e-3 * world.size  # a fiftieth of a pixel
    for image in read.images.values():
        assert np.abs(image.projection_center() - world.of_data(world.centers)[int(image.name[0])]).max() < accuracy
    points = np.array([read.points3D[key].xyz for key in sorted(read.points3D)])
    assert np.abs(points - world.of_data(world.points)).max() < accuracy


def test_a_usual_world_keeps_its_bits(tmp_path: Path) -> None:
    world = World(np.array([3.0, -2.0, 1.0]), 0.7, 1)
    with collecting() as notes:
        scene = load_scene(write_colmap(world, tmp_path / "data", text=False), tmp_path / "cache")
    assert (scene.placement, notes) == (Placement(), [])
    for view in [*scene.train, *scene.test]:
        pose = torch.from_numpy(world.poses()[int(view.name)])
        assert torch.allclose(view.camera.world_to_camera.double(), pose, rtol=2**-24, atol=1e-12)
    assert torch.equal(scene.points, torch.from_numpy(world.of_data(world.points)).float())


def own_source(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    """A source of one's own that hands in float64, kept by the cache too: a UTM world of half size."""

    def make() -> Scene:
        world, views = World(np.array(UTM), 0.5, 3), []
        for index, pose in enumerate(world.poses()):
            camera = Camera(
                torch.from_numpy(pose).to(settings["dtype"]),
                torch.tensor([[40.0, 0, 16], [0, 40, 12], [0, 0, 1]]).to(settings["dtype"]),
                WIDTH,
                HEIGHT,
            )
            depth = torch.full((HEIGHT, WIDTH), 1.5, dtype=settings["dtype"])
            views.append(View(str(index), camera, torch.zeros(HEIGHT, WIDTH, 3, dtype=torch.uint8), depth=depth))
        points = torch.from_numpy(world.of_data(world.points)).to(settings["dtype"])
        return Scene("own", views[1:], views[:1], points, torch.rand(60, 3), free_space=0.5, bounds=8.0)

    return cached_scene(cache_dir, "own", {"dtype": str(settings["dtype"])}, make)


def test_a_source_of_ones_own_is_placed_too(tmp_path: Path) -> None:
    given = {"kind": f"{__name__}:own_source", "dtype": torch.float64}
    for _ in ("made", "kept"):
        with collecting() as notes:
            scene = load_scene(given, tmp_path)
        World(np.array(UTM), 0.5, 3).assert_shown(scene)
        assert len(notes) == 1
        assert "the world is moved" in notes[0]
        assert scene.train[0].camera.world_to_camera.dtype == scene.points.dtype == torch.float32
        assert (scene.free_space, scene.bounds, float(scene.test[0].depth[0, 0])) == (0.5, 8.0, 1.5)


def test_lengths_follow_the_worlds_unit(tmp_path: Path) -> None:
    world = World(np.zeros(3), 0.01, 4)
    scene = load_scene({**write_colmap(world, tmp_path / "data", False), "free_space": 0.004, "bounds": 0.5}, tmp_path)
    unit = scene.placement.scale
    assert unit < 0.01
    assert (scene.free_space * unit, scene.bounds * unit) == (0.004, 0.5)
    written = export_scene(scene, tmp_path / "written", "blender")
    assert (written["free_space"], written["bounds"]) == (0.004, 0.5)


def test_digits_that_were_lost_before_are_noted(tmp_path: Path) -> None:
    """Points as float32 numbers beside cameras of all digits; all of a source in float32; six printed digits."""
    world = World(np.array(UTM), 1.0, 5)
    given = write_transforms(world, tmp_path / "data")
    write_points(world, tmp_path / "data/points.ply", "f4")
    with collecting() as notes:
        load_scene(given, tmp_path / "cache")
    assert any("the points are rounded to 0.5 units" in text for text in notes)
    assert not any("the cameras are rounded" in text for text in notes)
    with collecting() as notes:
        load_scene({"kind": f"{__name__}:own_source", "dtype": torch.float32}, tmp_path)
    assert any("the points are rounded to 0.5 units" in text for text in notes)
    model = write_colmap(world, tmp_path / "printed", text=True)
    path = tmp_path / "printed/sparse/0/points3D.txt"
    rows = [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]
    printed = [[row[0], *(f"{float(value):.7g}" for value in row[1:4]), *row[4:]] for row in rows]
    path.write_text("".join(f"{' '.join(row)}\n" for row in printed))
    with collecting() as notes:
        load_scene(model, tmp_path / "cache")
    assert any("the points are rounded to 1 units" in text for text in notes)


@pytest.mark.parametrize(("shift", "size"), [(UTM, 1.0), ((0.0, 0.0, 0.0), 0.01), (UTM, 1e-3)])
def test_random_points_lie_where_cameras_look(tmp_path: Path, shift: tuple[float, float, float], size: float) -> None:
    """As many of them, and as large, as beside NeRF's cameras at a distance of 4."""
    scene = load_scene(write_blender(World(np.array(shift), size, 6), tmp_path / "data", None), tmp_path / "cache")
    assert not scene.placement.unmoved
    distance = np.median([float(view.camera.project(scene.points.mean(0))[1]) for view in scene.train])
    assert float((scene.points.amax(0) - scene.points.amin(0)).max()) / 2 == pytest.approx(1.3 / 4 * distance, rel=0.1)
    for view in scene.train:
        pixels, depths = view.camera.project(scene.points)
        assert ((pixels - torch.tensor([16.0, 12.0])).abs() < 16).all(1).float().mean() > 0.5
        assert depths.min() > 0.2
