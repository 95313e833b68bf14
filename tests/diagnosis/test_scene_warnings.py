"""What is wrong with a scene is said before anything is trained on it, and nothing of a scene in order."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest
import torch
from toy_scenes import coarse_toys

from envgs_bench.core import Scene
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.diagnosis.scene_warnings import scene_notes, scene_warnings

SAYS = {  # kind of data -> what is said from which severity on
    "exposure": (2, ["exposures_differ"]),
    "white_balance": (2, ["exposures_differ"]),
    "jpeg": (2, ["views_blocky"]),
    "views": (2, ["views_sparse"]),
    "pose_rotation": (3, ["poses_off"]),
    "pose_translation": (3, ["poses_off"]),
    "points_fewer": (3, ["points_missing"]),
    "points_at_cameras": (3, ["points_missing", "points_unsupported"]),
    "points_near_cameras": (2, ["points_missing"]),
    "points_random": (1, ["points_unsupported"]),
    "normals_turned": (2, ["normals_disagree"]),
    "normals_mirrored": (1, ["normals_mirrored"]),
}
SAYS_NOTHING = [kind for kind in PERTURBATIONS if kind not in SAYS and not kind.startswith(("masks", "background"))]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    toy = {"kind": "toy", "scene": "chrome_room", "width": 40, "height": 30, "views": 48, "supersampling": 1}
    with coarse_toys():
        return load_scene(toy | {"normal_noise": 5.0}, tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def looked_at(room: Scene) -> Diagnosis:
    """The room in order, looked at once."""
    return Diagnosis(room)


def said(scene: Scene | Diagnosis, steps: int = 300, quickness: float = 1.0) -> list[str]:
    warnings = scene_warnings(scene if isinstance(scene, Diagnosis) else Diagnosis(scene), steps, quickness)
    assert all(warning.step == 0 for warning in warnings)
    return [warning.kind for warning in warnings]


def perturbed(scene: Scene, kind: str, severity: int) -> Scene:
    return PERTURBATIONS[kind].applied(scene, severity, kind, seed=0)


@pytest.mark.parametrize("kind", SAYS)
def test_what_breaks_a_training_without_a_word_is_said_at_its_start(room: Scene, kind: str) -> None:
    first, kinds = SAYS[kind]
    for severity in {first, len(PERTURBATIONS[kind].levels)}:  # the first and the worst, which may be the same
        assert said(perturbed(room, kind, severity)) == kinds
    if first > 1:
        assert len(said(perturbed(room, kind, first - 1))) < len(kinds)


@pytest.mark.parametrize("kind", SAYS_NOTHING)
def test_nothing_is_said_of_the_worst_of_what_a_training_survives(room: Scene, kind: str) -> None:
    assert said(perturbed(room, kind, len(PERTURBATIONS[kind].levels))) == []


def test_nothing_is_said_of_a_scene_in_order(looked_at: Diagnosis) -> None:
    assert said(looked_at) == []


def test_a_near_plane_behind_what_views_show_is_said(room: Scene) -> None:
    """At 0.2 none of the room's points is hidden; at its cameras' distance from the middle half of them are."""
    assert scene_warnings(Diagnosis(room), 300, near=0.2) == []
    (warning,) = scene_warnings(Diagnosis(room), 300, near=2.5)
    assert warning.kind == "near_hides"
    assert "nearer than 2.5 world units" in warning.message


@pytest.mark.parametrize(("times", "short"), [(1, True), (3.99, True), (4, False)])
def test_a_run_is_short_that_hardly_sees_its_views(looked_at: Diagnosis, times: float, short: bool) -> None:
    steps = int(times * len(looked_at.scene.train))
    assert said(looked_at, steps) == ["run_short"] * short
    if short:
        (warning,) = scene_warnings(looked_at, steps)
        assert f"{4 * len(looked_at.scene.train)} steps" in warning.message


@pytest.mark.parametrize(("quickness", "short"), [(0.5, True), (0.99, True), (1.0, False)])
def test_steps_at_lower_rates_are_fewer_steps(looked_at: Diagnosis, quickness: float, short: bool) -> None:
    views = len(looked_at.scene.train)
    assert said(looked_at, 4 * views, quickness) == ["run_short"] * short
    if short:
        (warning,) = scene_warnings(looked_at, 4 * views, quickness)
        assert f"{quickness:.2g} times the method's own learning rates" in warning.message
        steps = int(re.search(r"take (\d+) steps", warning.message)[1])
        assert said(looked_at, steps, quickness) == []
        assert said(looked_at, steps - 1, quickness) == ["run_short"]


def test_random_points_that_come_without_colors_are_what_synthetic_scenes_start_from(room: Scene) -> None:
    colors = torch.full_like(room.point_colors, 0.5) + torch.rand(room.point_colors.shape) * 0.001
    assert said(replace(perturbed(room, "points_random", 1), point_colors=colors)) == []


def test_points_of_one_color_say_nothing_of_poses(room: Scene) -> None:
    broken = perturbed(room, "pose_rotation", 3)
    assert said(replace(broken, point_colors=torch.full_like(room.point_colors, 0.5))) == []


def test_no_view_that_lacks_texture_normals_or_neighbors_is_an_error(room: Scene) -> None:
    blank = [replace(view, image=torch.zeros_like(view.image), normal=None) for view in room.train]
    assert said(replace(room, train=blank)) == ["points_unsupported"]
    assert said(replace(room, train=blank[:1])) == ["points_unsupported"]
    assert said(replace(room, train=room.train[:1])) == ["views_sparse"]


FACTS = {"run_short", "near_hides"}  # what a setting makes so, whatever the scene


@pytest.mark.parametrize("support", [1.0, 0.0])
def test_what_is_concluded_names_what_else_looks_like_it(support: float) -> None:
    """A scene of which everything is wrong, its points there or at random: their warnings exclude others."""
    seen = SimpleNamespace(hidden_share=lambda near: 1.0, colorless=False)
    wrong = SimpleNamespace(
        scene=SimpleNamespace(train=range(9)),
        photographs=SimpleNamespace(noise=1.0, detail=0.0, blockiness=1.0),
        photo_consistency=support,
        coverage=0.0,
        parallax=90.0,
        poses_told=True,
        points_in_order=True,
        alignment=SimpleNamespace(gain=1.0, degrees=2.0),
        exposures=SimpleNamespace(factors={"0": 2.0}, stops=1.0),
        mirrored=SimpleNamespace(views=["0"]),
        disagreement=90.0,
        observations=seen,
    )
    found = {warning.kind: warning.message for warning in scene_warnings(cast(Diagnosis, wrong), 1)}
    assert len(found) == (11 if support else 10)
    assert {kind for kind, text in found.items() if "; or " not in text and ", or the " not in text} <= FACTS


def test_few_points_are_noted_before_they_are_warned_of(room: Scene) -> None:
    """By eighths of the points: of all nothing is said, of some a number, and of hardly any that they are missing."""
    assert scene_notes(Diagnosis(room)) == []
    some = perturbed(room, "points_fewer", 2)
    assert [said(some), scene_notes(Diagnosis(some))] == [
        [],
        [
            "points lie in 64% of the parts of a training view that show something, too few to tell by them whether "
            "poses and exposures are right"
        ],
    ]
    assert scene_notes(Diagnosis(perturbed(room, "points_fewer", 3))) == []
