"""Points, poses and normals that the photographs contradict are repaired; what is in order stays as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from toy_scenes import coarse_toys, worst

from envgs_bench.core import Camera, Scene, View
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS
from envgs_bench.diagnosis.agreed_normals import with_agreed_normals
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.diagnosis.observations import Observations
from envgs_bench.diagnosis.plane_sweep import swept_points
from envgs_bench.diagnosis.points import repaired_points, with_far_points
from envgs_bench.diagnosis.repair import REPAIRS, repaired
from envgs_bench.records import RepairKind, RepairOutcome

NEAR = 0.2
CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    toy = {"kind": "toy", "scene": "chrome_room", "width": 40, "height": 30, "views": 33, "supersampling": 1}
    with coarse_toys():
        return load_scene(toy | {"normal_noise": 5.0}, tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def sky(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    toy = {"kind": "toy", "scene": "sky_ball", "width": 80, "height": 60, "views": 33, "supersampling": 2}
    with coarse_toys():
        return load_scene(toy, tmp_path_factory.mktemp("cache"))


def after(scene: Scene, kind: RepairKind) -> tuple[Scene, RepairOutcome]:
    found, (outcome,) = repaired(Diagnosis(scene), [kind], seed=0)
    assert (found.scene is not scene) == outcome.kept
    return found.scene, outcome


def off_surfaces(points: torch.Tensor, scene: Scene) -> np.ndarray:
    """How far the points [P, 3] are from the surfaces that the training views see, × the scene radius."""
    surfaces = []
    for view in scene.train:
        assert view.depth is not None
        origins, directions = view.camera.rays()
        surfaces.append((origins + view.depth[..., None] * directions)[view.depth > 0])
    return np.asarray(cKDTree(torch.cat(surfaces).numpy()).query(points.numpy())[0]) / scene.radius


def test_what_is_in_order_stays_as_it_is(room: Scene) -> None:
    given = Diagnosis(room)
    found, outcomes = repaired(given, list(REPAIRS), seed=0)
    assert found is given
    assert {outcome.kind: outcome.kept for outcome in outcomes} == dict.fromkeys(REPAIRS, False)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["points_random", "points_at_cameras", "points_near_cameras"])
def test_points_that_are_wrong_or_missing_are_found_on_the_surfaces(room: Scene, kind: str) -> None:
    broken = worst(room, kind)
    found = repaired_points(broken, NEAR, torch.Generator().manual_seed(0), CPU)
    assert len(found.points) > 300
    assert np.median(off_surfaces(found.points, room)) < 0.1


@pytest.mark.parametrize(("of_sky", "found", "distant"), [(True, (0.05, 1), (0.5, 1)), (False, (0.5, 1), (0, 0.005))])
def test_a_sky_is_found_far_away_and_no_surface_is(
    sky: Scene, of_sky: bool, found: tuple[float, float], distant: tuple[float, float]
) -> None:
    pixels = [torch.nonzero((view.depth == 0) == of_sky)[::7].flip(-1) + 0.5 for view in sky.train]
    near, far = 0.1 * sky.radius, 20 * sky.radius
    points, colors = swept_points(sky.train, pixels, near, far, torch.Generator().manual_seed(0), CPU)
    assert len(points) == len(colors)
    assert found[0] <= len(points) / sum(map(len, pixels)) <= found[1]
    centers = torch.stack([view.camera.center for view in sky.train])
    away = torch.cdist(points, centers).amin(dim=1)
    assert away.max() < 1.1 * far  # the depths are along the cameras' axes
    assert distant[0] <= (away > 1.5 * sky.radius).float().mean() <= distant[1]


@pytest.mark.parametrize(("severity", "repaired"), [(0, False), (3, True)])
def test_a_sky_without_points_gets_points_and_all_others_stay(sky: Scene, severity: int, repaired: bool) -> None:
    scene = PERTURBATIONS["points_far_fewer"].applied(sky, severity, "points_far_fewer", seed=0) if severity else sky
    generator = torch.Generator().manual_seed(0)
    before = generator.get_state()
    found = with_far_points(scene, NEAR, generator, CPU)
    assert (found is not scene) == repaired
    assert torch.equal(generator.get_state(), before) != repaired
    if repaired:
        added = found.points[len(scene.points) :]
        assert torch.equal(found.points[: len(scene.points)], scene.points)
        assert len(added) == len(found.point_colors) - len(scene.points) > 100
        centers = torch.stack([view.camera.center for view in sky.train])
        assert torch.cdist(added, centers).min() > 1.5 * sky.radius


def test_walls_without_a_sky_get_no_points_far_away(room: Scene) -> None:
    few = worst(room, "points_far_fewer")
    assert with_far_points(few, NEAR, torch.Generator().manual_seed(0), CPU) is few


def test_of_very_many_points_the_last_is_looked_at_too(room: Scene) -> None:
    """So many that their number has no neighbor in float32."""
    count = 2**24 + 4
    many = replace(room, points=torch.zeros(1, 3).expand(count, 3), point_colors=torch.zeros(1, 3).expand(count, 3))
    assert len(Observations.of(many, NEAR).points) == 4_000


def test_pictures_a_pixel_high_are_swept() -> None:
    views = [View(str(x), strip_at(x), torch.full((1, 640, 3), 90, dtype=torch.uint8)) for x in (0.0, 0.1, 0.2)]
    wanted = [torch.tensor([[320.5, 0.5]])] * len(views)
    points, colors = swept_points(views, wanted, 0.5, 20.0, torch.Generator().manual_seed(0), CPU)
    assert (points.shape, colors.shape) == ((0, 3), (0, 3))  # of one color: no depth is clear


def strip_at(x: float) -> Camera:
    """A camera of 640×1 pixels that looks along z."""
    pose = torch.eye(4)
    pose[0, 3] = -x
    return Camera(pose, torch.tensor([[500.0, 0, 320], [0, 500, 0.5], [0, 0, 1]]), 640, 1)


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_views_with_mirrored_normals_are_found_and_mirrored_back(room: Scene, share: float) -> None:
    level = [0.25, 0.5, 1.0].index(share) + 1
    broken = PERTURBATIONS["normals_mirrored"].applied(room, level, "normals_mirrored", seed=0)
    changed = [b.name for a, b in zip(room.train, broken.train, strict=True) if a is not b]
    assert len(changed) == round(share * len(room.train))
    assert Diagnosis(broken).mirrored == changed
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
        found, _ = repaired(Diagnosis(scene), ["normals"], seed=0)
        prior = with_agreed_normals(found).normals
        assert prior is not None
        weights.append(prior.weight)
        assert ("as much" in prior.notes[-1]) == bool(severity)
    assert weights[0] == 1
    assert 0.4 < weights[1] < 0.8
    assert 0.1 < weights[2] < 0.3


def test_views_are_turned_back(room: Scene) -> None:
    """Their normals, too, which had turned with them."""
    broken = worst(room, "pose_rotation")
    found, _ = after(broken, "poses")
    off = {"given": [], "repaired": []}
    for exact, *both in zip(room.train, broken.train, found.train, strict=True):
        for kind, each in zip(off, both, strict=True):
            off[kind].append(float((each.normal - exact.normal).norm(dim=-1).mean()))
            torch.testing.assert_close(each.camera.center, exact.camera.center, atol=1e-5, rtol=0)
    assert np.mean(off["repaired"]) < np.mean(off["given"]) / 5


def test_points_that_are_missing_or_of_one_color_turn_no_view(room: Scene) -> None:
    broken = worst(room, "pose_rotation")
    gray = replace(broken, point_colors=torch.full_like(room.point_colors, 0.5))
    few = replace(broken, points=broken.points[::12], point_colors=broken.point_colors[::12])
    for scene in (gray, few):
        found, outcome = after(scene, "poses")
        assert found is scene
        assert "say nothing" in outcome.message


def test_repairs_are_done_in_one_order_whatever_was_asked_for_first(room: Scene) -> None:
    few = replace(room, points=room.points[::12], point_colors=room.point_colors[::12])
    mirrored = PERTURBATIONS["normals_mirrored"].applied(few, 1, "normals_mirrored", seed=0)
    found, (points, normals) = repaired(Diagnosis(mirrored), ["normals", "points"], seed=0)
    assert points.message.startswith(f"{len(found.scene.points):,} points in place of {len(few.points):,}")
    assert normals.message == f"the normals of 7 of {len(room.train)} training views are mirrored back"
    assert points.evidence.keys() == {"photo_consistency", "coverage"}
    assert found.scene.test is mirrored.test
