"""Poses and mirrored normals are repaired, and what is in order stays as it is; of exposures: `test_exposures`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from toy_scenes import coarse_toys, worst

from envgs_bench.core import Scene
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS
from envgs_bench.diagnosis.agreed_normals import with_agreed_normals
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.diagnosis.observations import Observations
from envgs_bench.diagnosis.repair import REPAIRS, repaired
from envgs_bench.records import RepairKind, RepairOutcome

NEAR = 0.2
CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    toy = {"kind": "toy", "scene": "chrome_room", "width": 40, "height": 30, "views": 33, "supersampling": 1}
    with coarse_toys():
        return load_scene(toy | {"normal_noise": 5.0}, tmp_path_factory.mktemp("cache"))


def after(scene: Scene, kind: RepairKind) -> tuple[Scene, RepairOutcome]:
    found, (outcome,) = repaired(Diagnosis(scene), [kind])
    assert (found.scene is not scene) == outcome.kept
    return found.scene, outcome


def test_what_is_in_order_stays_as_it_is(room: Scene) -> None:
    given = Diagnosis(room)
    found, outcomes = repaired(given, list(REPAIRS))
    assert found is given
    assert {outcome.kind: outcome.kept for outcome in outcomes} == dict.fromkeys(REPAIRS, False)


def test_of_very_many_points_the_last_is_looked_at_too(room: Scene) -> None:
    """So many that their number has no neighbor in float32."""
    count = 2**24 + 4
    many = replace(room, points=torch.zeros(1, 3).expand(count, 3), point_colors=torch.zeros(1, 3).expand(count, 3))
    assert len(Observations.of(many, NEAR).points) == 4_000


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_views_with_mirrored_normals_are_found_and_mirrored_back(room: Scene, share: float) -> None:
    level = [0.25, 0.5, 1.0].index(share) + 1
    broken = PERTURBATIONS["normals_mirrored"].applied(room, level, "normals_mirrored", seed=0)
    changed = [b.name for a, b in zip(room.train, broken.train, strict=True) if a is not b]
    assert len(changed) == round(share * len(room.train))
    assert Diagnosis(broken).mirrored.views == changed
    found, outcome = after(broken, "normals")
    assert outcome.message == f"the normals of {len(changed)} of {len(room.train)} training views are mirrored back"
    for exact, view in zip(room.train, found.train, strict=True):
        torch.testing.assert_close(view.normal, exact.normal, atol=1e-5, rtol=0)


@pytest.mark.parametrize("mirrored", [False, True])
def test_normals_count_less_the_less_views_agree_on_them(room: Scene, mirrored: bool) -> None:
    """As the inverse of the variance that is left once they are corrected, be they mirrored back before or not."""
    weights = []
    for severity in (0, 2, 3):
        scene = PERTURBATIONS["normals_turned"].applied(room, severity, "normals_turned", seed=0) if severity else room
        if mirrored:
            scene = PERTURBATIONS["normals_mirrored"].applied(scene, 3, "normals_mirrored", seed=0)
        found, _ = repaired(Diagnosis(scene), ["normals"])
        prior = with_agreed_normals(found).normals
        assert prior is not None
        weights.append(prior.weight)
        assert ("as much" in prior.notes[-1]) == bool(severity)
    assert weights[0] == 1
    assert 0.4 < weights[1] < 0.8
    assert 0.1 < weights[2] < 0.3


def test_repairs_are_done_in_one_order_whatever_was_asked_for_first(room: Scene) -> None:
    broken = PERTURBATIONS["exposure"].applied(room, 3, "exposure", seed=0)
    broken = PERTURBATIONS["normals_mirrored"].applied(broken, 1, "normals_mirrored", seed=0)
    found, (exposures, normals) = repaired(Diagnosis(broken), ["normals", "exposures"])
    assert exposures.message.endswith("the median view's")
    assert normals.message == f"the normals of 7 of {len(room.train)} training views are mirrored back"
    assert exposures.measured.keys() == {"stops"}
    assert found.scene.test is broken.test


def test_views_are_turned_back(room: Scene) -> None:
    """Their normals, too, which had turned with them."""
    broken = worst(room, "pose_rotation")
    found, outcome = after(broken, "poses")
    off: dict[str, list[float]] = {"given": [], "repaired": []}
    for exact, *both in zip(room.train, broken.train, found.train, strict=True):
        for kind, each in zip(off, both, strict=True):
            off[kind].append(float((each.normal - exact.normal).norm(dim=-1).mean()))
            torch.testing.assert_close(each.camera.center, exact.camera.center, atol=1e-5, rtol=0)
    assert np.mean(off["repaired"]) < np.mean(off["given"]) / 5
    assert outcome.measured["degrees"] == pytest.approx(2, abs=0.5)


def test_points_that_are_missing_or_of_one_color_turn_no_view(room: Scene) -> None:
    broken = worst(room, "pose_rotation")
    gray = replace(broken, point_colors=torch.full_like(room.point_colors, 0.5))
    few = replace(broken, points=broken.points[::12], point_colors=broken.point_colors[::12])
    for scene in (gray, few):
        found, outcome = after(scene, "poses")
        assert found is scene
        assert "say nothing" in outcome.message


def test_normals_are_judged_by_the_poses_that_were_found_before(room: Scene) -> None:
    broken = worst(PERTURBATIONS["normals_mirrored"].applied(room, 1, "normals_mirrored", seed=0), "pose_rotation")
    found, outcomes = repaired(Diagnosis(broken), ["normals", "poses"])
    assert [(outcome.kind, outcome.kept) for outcome in outcomes] == [("poses", True), ("normals", True)]
    assert found.scene.test is broken.test
