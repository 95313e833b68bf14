"""Scenes of any source against themselves: a world of known color, seen by right cameras and by wrong ones."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from envgs_bench.core import Camera, Scene, View
from envgs_bench.datasets import DatasetError
from envgs_bench.datasets.consistency.scenes import check_scene
from envgs_bench.datasets.notes import collecting

COUNT, SIZE, FOCAL = 12, 48, 60.0


def wall(points: Tensor) -> Tensor:
    """Colors [..., 3] in [0, 1] of the plane z = 0, no two parts of which look alike."""
    x, y = points[..., 0], points[..., 1]
    return 0.5 + 0.45 * torch.stack([torch.sin(2 * x + y), torch.sin(1.7 * y + 1 - x), torch.sin(x * y + 2 * x)], -1)


def camera_at(index: int) -> Camera:
    """Before the wall, four units away, a step aside of the one before, turned a little."""
    angle = torch.tensor(0.05 * index)
    pose = torch.eye(4)
    pose[:2, :2] = torch.tensor([[angle.cos(), -angle.sin()], [angle.sin(), angle.cos()]])
    pose[:3, 3] = torch.tensor([0.1 * (index - COUNT / 2), 0.05 * index, 4.0])
    k = torch.tensor([[FOCAL, 0, SIZE / 2], [0, FOCAL, SIZE / 2], [0, 0, 1]])
    return Camera(pose, k, SIZE, SIZE)


def picture_of(camera: Camera) -> Tensor:
    origins, directions = camera.rays()
    places = origins - directions * (origins[..., 2:] / directions[..., 2:])
    return (255 * wall(places)).round().byte()


def scene() -> Scene:
    views = [View(f"{i:02d}", camera_at(i), picture_of(camera_at(i))) for i in range(COUNT)]
    points = torch.cat([4 * torch.rand(600, 2, generator=torch.Generator().manual_seed(0)) - 2, torch.zeros(600, 1)], 1)
    return Scene("wall", views[1:], views[:1], points, wall(points))


def changed(change: Callable[[View, int], View]) -> Scene:
    right = scene()
    views = [change(view, i) for i, view in enumerate([*right.test, *right.train])]
    return replace(right, train=views[1:], test=views[:1])


def notes_of(one: Scene) -> list[str]:
    with collecting() as notes:
        check_scene(one, "data")
    return notes


def with_camera(view: View, **changes: object) -> View:
    return replace(view, camera=replace(view.camera, **changes))


def turned(view: View, *signs: float) -> View:
    return with_camera(view, world_to_camera=torch.diag(torch.tensor([*signs, 1.0])) @ view.camera.world_to_camera)


def test_a_right_scene_passes_silently() -> None:
    assert notes_of(scene()) == []


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (
            lambda view, i: with_camera(view, world_to_camera=torch.eye(4)),
            "all 12 views have one pose .*transform_matrix",
        ),
        (lambda view, i: turned(view, 1, -1, -1), "all points lie behind all 12 views .*axes"),
        (
            lambda view, i: with_camera(
                view, intrinsics=torch.diag(torch.tensor([2.0, 2, 1])) @ view.camera.intrinsics
            ),
            "view 01: its camera .*the principal point of pictures of 96×96 pixels",
        ),
    ],
    ids=["one pose", "axes", "size"],
)
def test_what_cannot_be_is_refused(change: Callable[[View, int], View], what: str) -> None:
    with pytest.raises(DatasetError, match=rf"^data: {what}"):
        check_scene(changed(change), "data")


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda view, i: replace(view, image=view.image.flip(0, 1)), "the pictures are turned by 180°"),
        (lambda view, i: replace(view, image=view.image.flip(1)), "the pictures are mirrored from left to right"),
        (lambda view, i: replace(view, image=view.image.flip(0)), "the pictures are upside down and mirrored"),
        (lambda view, i: replace(view, image=view.image.roll(19, 0).roll(11, 1)), "do not show the points' colors"),
        (lambda view, i: turned(view, -1, 1, -1) if i == 5 else view, "1 of 12 views see none of the points: 05"),
        (lambda view, i: replace(view, camera=camera_at(4)) if i == 5 else view, "2 of 12 views .*pose of another one"),
        (
            lambda view, i: replace(view, image=picture_of(camera_at(4))) if i == 5 else view,
            "2 of 12 .*picture of another",
        ),
    ],
    ids=["turned", "mirrored", "upside down", "shifted", "away", "pose twice", "picture twice"],
)
def test_what_is_odd_is_noted(change: Callable[[View, int], View], what: str) -> None:
    (text,) = notes_of(changed(change))
    assert text.startswith("data: ")
    assert re.search(what, text), text


def test_a_camera_that_only_turns_is_noted() -> None:
    def around(view: View, index: int) -> View:
        pose = view.camera.world_to_camera.clone()
        pose[:3, 3] = torch.tensor([0.0, 0, 4])
        moved = replace(view.camera, world_to_camera=pose)
        return View(view.name, moved, picture_of(moved))

    (text,) = notes_of(changed(around))
    assert "taken from one place" in text


def test_random_clouds_say_nothing_of_pictures() -> None:
    right = scene()
    gray = replace(right, point_colors=torch.full_like(right.point_colors, 0.5))
    assert notes_of(replace(gray, train=[replace(v, image=v.image.flip(0)) for v in gray.train])) == []
