"""Estimated normals brought into agreement, against the exact ones that the toys know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation
from torch import Tensor
from toy_scenes import coarse_toys

from envgs_bench.core import Scene
from envgs_bench.core.vectors import rotated, unit
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS
from envgs_bench.diagnosis.agreed_normals import with_agreed_normals
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.diagnosis.normal_agreement import (
    LEAST_POINTS,
    ROUGHNESS,
    SIZE,
    NormalAgreement,
    _Bend,
    corrected,
    normal_agreement,
)
from envgs_bench.diagnosis.observations import Observations
from envgs_bench.methods.registry import create_method

NEAR = 0.2
AS_GIVEN = NormalAgreement(torch.zeros(0))
TOY = {"kind": "toy", "scene": "chrome_room", "width": 40, "height": 30, "views": 33, "supersampling": 1}


@pytest.fixture(scope="module")
def exact(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    with coarse_toys():
        return load_scene(TOY | {"normal_noise": 0.0}, tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def estimated(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    with coarse_toys():
        return load_scene(TOY | {"normal_noise": 5.0}, tmp_path_factory.mktemp("cache"))


def agreed(scene: Scene) -> NormalAgreement:
    observations = Observations.of(scene, NEAR)
    return normal_agreement(observations, observations.seen_normals)


def degrees(scene: Scene, found: NormalAgreement, exact: Scene, region: str | None = None) -> float:
    """By how much the corrected normals of the training views are off on average, there."""
    angles = []
    for view, truth in zip(scene.train, exact.train, strict=True):
        assert truth.normal is not None
        given = view.normal
        if view.name in found.corrections:
            given = corrected(given, found.corrections[view.name])
        known = truth.normal.any(dim=-1) & (truth.masks[region] if region else True)
        angles.append((given * truth.normal).sum(dim=-1)[known].clamp(-1, 1).acos().rad2deg())
    return float(torch.cat(angles).mean())


def test_what_views_say_together_is_nearer_to_the_truth_on_mirrors_too(estimated: Scene, exact: Scene) -> None:
    found = agreed(estimated)
    assert degrees(estimated, AS_GIVEN, exact) == pytest.approx(5, abs=0.3)
    assert degrees(estimated, found, exact) < 3.6
    assert degrees(estimated, found, exact, "reflective") < 0.8 * degrees(estimated, AS_GIVEN, exact, "reflective")
    assert found.corrections.keys() == {view.name for view in estimated.train}


def test_so_it_is_where_estimates_are_far_off(estimated: Scene, exact: Scene) -> None:
    worse = PERTURBATIONS["normals_turned"].applied(estimated, 2, "normals_turned", seed=0)  # by 15° more
    before, after = (degrees(worse, found, exact) for found in (AS_GIVEN, agreed(worse)))
    assert before > 14
    assert after < 0.75 * before


def test_normals_that_agree_stay_to_the_last_bit(exact: Scene) -> None:
    assert agreed(exact).corrections == {}
    prior = with_agreed_normals(Diagnosis(exact)).normals
    assert prior is not None
    assert all(prior.agreed(view) is view for view in exact.train)
    assert (prior.weight, list(prior.notes)) == (1.0, [])


def test_views_that_are_turned_are_turned_back(exact: Scene) -> None:
    """By what varies over their pictures; and the others, which were right, not at all."""
    height, width = exact.train[3].normal.shape[:2]
    x = torch.linspace(0, 1, width).expand(height, width)
    y = torch.linspace(0, 1, height)[:, None].expand(height, width)
    field = torch.stack([0.5 * x - 0.2, 0.4 * y, 0.3 - 0.5 * x * y], dim=-1)
    views = list(exact.train)
    for index in range(0, len(views), 7):
        views[index] = replace(views[index], normal=rotated(views[index].normal, field))
    turned = replace(exact, train=views)
    found = agreed(turned)
    assert list(found.corrections) == [view.name for view in views[::7]]
    few, truth = replace(turned, train=views[::7]), replace(exact, train=exact.train[::7])
    assert degrees(few, found, truth) < degrees(few, AS_GIVEN, truth) / 4


def test_corrections_are_bilinear_between_the_corners_of_cells() -> None:
    """As SciPy interpolates, and turns."""
    generator = torch.Generator().manual_seed(0)
    corners = torch.randn(4, 7, 3, generator=generator)
    normals = unit(torch.randn(9, 14, 3, generator=generator))
    normals[2, 5] = 0
    rows, columns = (np.arange(9) + 0.5) / 9 * 3, (np.arange(14) + 0.5) / 14 * 6
    interpolated = RegularGridInterpolator((np.arange(4), np.arange(7)), corners.double().numpy())
    vectors = interpolated(np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)).reshape(-1, 3)
    expected = Rotation.from_rotvec(vectors).apply(normals.reshape(-1, 3).double().numpy()).reshape(9, 14, 3)
    torch.testing.assert_close(corrected(normals, corners).double(), torch.from_numpy(expected), atol=2e-6, rtol=0)
    torch.testing.assert_close(corrected(normals, torch.zeros(4, 7, 3)), normals, atol=0, rtol=0)


def test_rotations_are_those_of_least_squares(estimated: Scene) -> None:
    """By NumPy's solver, rows for turns of normals, differences of neighbors and rotations."""
    observations = Observations.of(estimated, NEAR)
    bend = _Bend.over(observations, 0, observations.seen_normals[0].any(dim=-1))
    generator = torch.Generator().manual_seed(0)
    points = len(observations.points)
    given = unit(torch.randn(points, 3, generator=generator))
    common = unit(given + 0.2 * torch.randn(points, 3, generator=generator))
    found = bend.fitted(given, common, common, torch.ones(points, dtype=torch.bool))  # nothing is left: all count fully
    (rows, columns, _), shares = found.shape, bend.shares.double().numpy()
    own, to = (x[bend.rows].double().numpy() for x in (given, common))
    axis = np.cross(own, to)
    turn = axis / np.linalg.norm(axis, axis=1)[:, None] * np.arccos((own * to).sum(axis=1))[:, None]
    across = np.eye(3) - own[:, :, None] * own[:, None]
    grid = np.arange(rows * columns).reshape(rows, columns)
    pairs = [*zip(grid[1:].flat, grid[:-1].flat, strict=True), *zip(grid[:, 1:].flat, grid[:, :-1].flat, strict=True)]
    steps = np.stack([np.eye(grid.size)[a] - np.eye(grid.size)[b] for a, b in pairs])
    penalties = np.concatenate([ROUGHNESS**0.5 * steps, SIZE**0.5 * np.eye(grid.size)])
    system = np.concatenate(
        [np.einsum("kr,kab->karb", shares, across).reshape(-1, 3 * grid.size), np.kron(penalties, np.eye(3))]
    )
    wanted = np.concatenate([turn.flatten(), np.zeros(3 * len(penalties))])
    expected = np.linalg.lstsq(system, wanted, rcond=None)[0].reshape(rows, columns, 3)
    assert np.abs(expected).max() > 0.05
    np.testing.assert_allclose(found.double().numpy(), expected, atol=1e-5)


def test_views_that_show_too_few_points_stay(estimated: Scene) -> None:
    few = replace(estimated, points=estimated.points[:LEAST_POINTS], point_colors=estimated.point_colors[:LEAST_POINTS])
    assert agreed(few).corrections == {}
    two = replace(estimated, train=estimated.train[:2])
    assert agreed(two).corrections == {}


def test_a_method_learns_from_what_agrees_and_says_so(estimated: Scene) -> None:
    small = {"env_grid": 2, "env_far_count": 10}
    scene = with_agreed_normals(Diagnosis(estimated))
    terms: dict[str, Tensor] = {}
    for normals in ("agreed", "as_given"):
        method = create_method("envgs", small | {"rules": {"normals": normals}})
        assert method.needs.agreed_normals == (normals == "agreed")
        method.initialize(scene, steps=10)
        terms[normals] = method.training_step(scene.train[0], 1)["mono"]
        assert any("to agree" in note for note in method.notes) == (normals == "agreed")
    assert not torch.isclose(terms["agreed"], terms["as_given"], rtol=1e-3)
