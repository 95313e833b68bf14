"""Views that look elsewhere than their poses say are turned back by what they show of the points; others stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from toy_scenes import coarse_toys

from envgs_bench.core import Scene, View
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS
from envgs_bench.diagnosis.observations import Observations
from envgs_bench.diagnosis.poses import FEWEST, alignment, turned
from envgs_bench.testing import NotFinite


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    toy = {"kind": "toy", "scene": "chrome_room", "width": 40, "height": 30, "views": 33, "supersampling": 1}
    with coarse_toys():
        return load_scene(toy | {"normal_noise": 5.0}, tmp_path_factory.mktemp("cache"))


def perturbed(scene: Scene, kind: str, severity: int) -> Scene:
    return PERTURBATIONS[kind].applied(scene, severity, kind, seed=0)


def aligned_views(scene: Scene) -> list[View]:
    found = alignment(Observations.of(scene, 0.0))
    return [turned(view, turn) for view, turn in zip(scene.train, found.turns, strict=True)]


def degrees_between(views: list[View], others: list[View]) -> np.ndarray:
    """Angles [V] between what two lists of views have as poses."""
    first, second = (
        Rotation.from_matrix([view.camera.world_to_camera[:3, :3].double().numpy() for view in each])
        for each in (views, others)
    )
    return np.degrees((first * second.inv()).magnitude())


@pytest.mark.parametrize("exposed", [False, True])
def test_turns_of_two_degrees_are_found_whatever_the_exposure(room: Scene, exposed: bool) -> None:
    wrong = perturbed(room, "pose_rotation", 3)
    assert degrees_between(wrong.train, room.train).mean() > 1.5
    found = aligned_views(perturbed(wrong, "exposure", 2) if exposed else wrong)
    assert degrees_between(found, room.train).mean() < 0.35
    assert degrees_between(found, room.train).max() < 1


def test_views_in_order_gain_nothing_by_a_turn(room: Scene) -> None:
    found = alignment(Observations.of(room, 0.0))
    assert found.gain < 0.03
    assert found.degrees < 0.3


def test_a_turned_view_has_its_old_center_and_normals_in_its_own_axes(room: Scene) -> None:
    """As the perturbation has, which wrote the same in NumPy."""
    turn = torch.from_numpy(Rotation.from_rotvec([0.02, -0.03, 0.05]).as_matrix()).float()
    view = room.train[3]
    found = turned(view, turn)
    assert degrees_between([found], [view]) == pytest.approx(np.degrees(np.linalg.norm([0.02, -0.03, 0.05])), rel=1e-3)
    torch.testing.assert_close(found.camera.center, view.camera.center, atol=1e-5, rtol=0)
    assert view.normal is not None
    assert found.normal is not None
    pairs = ((view.normal, view.camera), (found.normal, found.camera))
    in_camera = [normal @ camera.world_to_camera[:3, :3].T for normal, camera in pairs]
    torch.testing.assert_close(*in_camera, atol=1e-5, rtol=0)
    back = turned(found, turn.T)
    torch.testing.assert_close(back.camera.world_to_camera, view.camera.world_to_camera, atol=1e-5, rtol=0)
    torch.testing.assert_close(back.normal, view.normal, atol=1e-5, rtol=0)


def test_what_shows_nothing_or_too_little_stays_as_it_is(room: Scene) -> None:
    wrong = perturbed(room, "pose_rotation", 3)
    few = replace(wrong, points=room.points[: FEWEST - 1], point_colors=room.point_colors[: FEWEST - 1])
    blank = replace(wrong, train=[replace(view, image=torch.zeros_like(view.image)) for view in wrong.train])
    unseen = replace(wrong, train=wrong.train[:1], points=wrong.train[0].camera.center.repeat(50, 1))
    at_cameras = perturbed(wrong, "points_at_cameras", 3)
    for scene in (few, blank, unseen):
        assert degrees_between(aligned_views(scene), scene.train).max() == 0
    assert alignment(Observations.of(at_cameras, 0.0)).turns.isfinite().all()


def test_a_view_whose_picture_is_not_finite_stays_and_leaves_the_others_theirs(room: Scene) -> None:
    wrong = perturbed(room, "pose_rotation", 3)
    spoiled = replace(wrong, train=[NotFinite(**vars(wrong.train[0])), *wrong.train[1:]])
    found = aligned_views(spoiled)
    assert degrees_between(found[:1], wrong.train[:1]).max() == 0
    assert degrees_between(found[1:], room.train[1:]).max() < 1
