"""What test views show that training views show too: against closed forms, and against the views' own depth maps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from toy_scenes import BLACK, GRAY, rough_toys

from envgs_bench.core import Camera, Scene, View
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.toy.cameras import look_at
from envgs_bench.datasets.toy.covisibility import covisible
from envgs_bench.datasets.toy.render import geometry
from envgs_bench.datasets.toy.shapes import Rectangle
from envgs_bench.datasets.toy.world import Part, World

WALL = Part(Rectangle((-50, 4, -50), (100, 0, 0), (0, 0, 100)), GRAY)  # the plane y = 4
SIZE = 60


def camera(x: float, turned: float = 0.0, degrees: float = 90.0) -> Camera:
    """At (x, 0, 0), looking along y, turned to the right by so many degrees; a square picture."""
    angle = np.radians(turned)
    center = np.array([x, 0.0, 0.0])
    pose = look_at(center, center + np.array([np.sin(angle), np.cos(angle), 0.0]))
    focal = SIZE / (2 * np.tan(np.radians(degrees) / 2))
    intrinsics = torch.tensor([[focal, 0, SIZE / 2], [0, focal, SIZE / 2], [0, 0, 1]])
    return Camera(torch.from_numpy(pose).float(), intrinsics, SIZE, SIZE)


def seen(parts: list[Part], view: Camera, *others: Camera) -> np.ndarray:
    world = World(parts, BLACK)
    return covisible(world, view, geometry(world, view).depth, others)


def positions(view: Camera, y: float) -> tuple[np.ndarray, np.ndarray]:
    """x and z [H, W] of where the pixels' rays meet the plane y."""
    origins, directions = (rays.double().numpy() for rays in view.rays())
    points = origins + (y - origins[..., 1:2]) / directions[..., 1:2] * directions
    return points[..., 0], points[..., 2]


def test_a_wall_is_covisible_as_far_as_another_picture_reaches() -> None:
    view, other = camera(0.0), camera(3.13)
    x, _ = positions(view, 4.0)  # the other's field of 90° ends 4 to its left
    np.testing.assert_array_equal(seen([WALL], view, other), x > 3.13 - 4)


def test_the_sky_is_covisible_where_a_direction_is_in_the_picture_wherever_the_other_camera_is() -> None:
    view, other = camera(0.0), camera(1000.0, turned=20.0)
    x, z = positions(view, 1.0)
    azimuth = np.degrees(np.arctan(x)) - 20
    # in the other camera's frame the direction is (sin, −z, cos), and its picture reaches as far as it is deep
    length = np.hypot(x, 1)
    expected = (abs(np.tan(np.radians(azimuth))) < 1) & (abs(z) < length * np.cos(np.radians(azimuth)))
    behind = Part(Rectangle((-1, -5, -1), (2, 0, 0), (0, 0, 2)), GRAY)  # behind both cameras
    np.testing.assert_array_equal(seen([behind], view, other), expected)
    assert 0.5 < expected.mean() < 0.9


def test_what_something_hides_from_the_other_camera_is_not_covisible() -> None:
    screen = Part(Rectangle((1.0, 2.0, -0.45), (1.0, 0, 0), (0, 0, 0.9)), GRAY)  # x 1 to 2, z ±0.45, at y = 2
    view, other = camera(0.0), camera(3.13)
    found = seen([WALL, screen], view, other)
    x, z = positions(view, 4.0)
    # from (3.13, 0) the screen hides on the wall what lies twice as far: x −1.13 to 0.87, z ±0.9
    behind = (x > 2 * 1.0 - 3.13) & (x < 2 * 2.0 - 3.13) & (abs(z) < 0.9)
    on_screen = (x > 2) & (x < 4) & (abs(z) < 0.9)  # as the view sees it, drawn on the wall
    np.testing.assert_array_equal(found, np.where(on_screen, x / 2 > 3.13 - 2, (x > 3.13 - 4) & ~behind))
    assert behind.sum() > 100


def test_one_training_view_of_many_is_enough() -> None:
    view, others = camera(0.0), (camera(9.0), camera(3.13), camera(-3.13))
    assert seen([WALL], view, *others).all()
    assert not seen([WALL], view).any()


def test_the_wall_s_own_roughness_in_float_hides_nothing() -> None:
    """At a grazing angle, far away, and seen from beside."""
    floor = Part(Rectangle((-500, 0, -1), (1000, 0, 0), (0, 1000, 0)), GRAY)
    world = World([floor], BLACK)
    view = camera(0.0)
    depth = geometry(world, view).depth
    far = (depth > 0) & (depth < 200)
    assert far[: SIZE // 2 + 2].any()
    assert covisible(world, view, depth, [camera(-0.7, degrees=140.0)])[far].all()


@pytest.fixture(scope="module")
def load(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Scene]:
    cache = tmp_path_factory.mktemp("cache")
    small = {"kind": "toy", "width": 96, "height": 72, "views": 17, "supersampling": 1}
    with rough_toys():
        yield lambda scene, **settings: load_scene({**small, "scene": scene, **settings}, cache)


def seen_by_depth(view: View, others: list[View]) -> torch.Tensor:
    """[H, W] as `covisible`, by comparing the views' depth maps, where nothing bends or ends within a pixel."""
    origins, directions = view.camera.rays()
    sky = view.depth == 0
    points = origins + torch.where(sky, 1e6, view.depth)[..., None] * directions
    found = torch.zeros_like(sky)
    for other in others:
        pixels, depth = other.camera.project(points)
        column, row = pixels.floor().long().unbind(-1)
        inside = (depth > 0) & (row >= 0) & (column >= 0) & (row < sky.shape[0]) & (column < sky.shape[1])
        there = other.depth[row.clamp(0, sky.shape[0] - 1), column.clamp(0, sky.shape[1] - 1)]
        found |= inside & torch.where(sky, there == 0, (there - depth).abs() < 0.03 * depth)
    return found


@pytest.mark.parametrize("name", ["chrome_room", "lacquered_table", "sky_ball"])
def test_toys_agree_with_their_depth_maps(load: Callable[..., Scene], name: str) -> None:
    scene = load(name)
    for view in scene.test:
        found, expected = view.masks["covisible"], seen_by_depth(view, scene.train)
        assert (found | ~expected).float().mean() > 0.995  # a depth map's pixel may lie beside what it is asked for
        assert (found == expected).float().mean() > 0.95  # and says nothing where a surface is steep
        assert not found.all()


def test_only_what_does_not_train_has_the_region(load: Callable[..., Scene]) -> None:
    scene = load("lacquered_table", validation=True)
    assert all("covisible" not in view.masks for view in scene.train)
    for view in scene.val:
        expected = seen_by_depth(view, scene.train)
        assert (view.masks["covisible"] == expected).float().mean() > 0.95
        assert seen_by_depth(view, [view]).all()  # it would see all of itself, were it left in the training views
        assert not view.masks["covisible"].all()
