"""Flat mirrors that show rooms behind them are told from what has the normals that it is given."""

from __future__ import annotations

import pytest
import torch
from toy_scenes import coarse_toys, worst

from envgs_bench.core import Scene
from envgs_bench.core.normal_prior import NormalPrior, normals_outside, pixels_in, share_of
from envgs_bench.datasets import load_scene
from envgs_bench.diagnosis.agreed_normals import with_agreed_normals
from envgs_bench.diagnosis.coverage import CELLS
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.diagnosis.plane_sweep import SweptView
from envgs_bench.diagnosis.seen_through import SeenThrough, seen_through
from envgs_bench.diagnosis.thresholds import MAYBE_SEEN_THROUGH, SEEN_THROUGH

NEAR = 0.2
CPU = torch.device("cpu")
TOY = {"kind": "toy", "width": 96, "height": 72, "views": 33, "supersampling": 2, "normal_noise": 5.0}


@pytest.fixture(scope="module")
def toys(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Scene]:
    with coarse_toys():
        kinds = ("facing_mirrors", "chrome_room", "diffuse_room")
        return {kind: load_scene(TOY | {"scene": kind}, tmp_path_factory.mktemp("cache")) for kind in kinds}


def shares(scene: Scene) -> tuple[float, float]:
    """Of what reflects in the training views, and of all else, how much is taken for seen through glass."""
    found = seen_through(scene.train, 0.1 * scene.radius, 20 * scene.radius, CPU).sure
    counts = torch.zeros(2, 2)  # what reflects or not; seen through, and all
    for view in scene.train:
        assert view.normal is not None
        known = view.normal.any(dim=-1)
        left = normals_outside(view.normal, found.get(view.name, torch.zeros(CELLS, CELLS, dtype=torch.bool))).any(
            dim=-1
        )
        reflects = view.masks.get("reflective", torch.zeros_like(known))
        for row, where in enumerate((reflects & known, ~reflects & known)):
            counts[row] += torch.stack([(where & ~left).sum(), where.sum()])
    through, all_of_it = counts.unbind(dim=1)
    return tuple((through / all_of_it.clamp_min(1)).tolist())


def prior_of(scene: Scene) -> NormalPrior:
    found = with_agreed_normals(Diagnosis(scene)).normals
    assert found is not None
    return found


def test_flat_mirrors_are_seen_through_and_walls_are_not(toys: dict[str, Scene]) -> None:
    mirrors, walls = shares(toys["facing_mirrors"])
    assert mirrors > 0.35
    assert walls < 0.03


@pytest.mark.parametrize("kind", ["chrome_room", "diffuse_room"])
def test_curved_mirrors_and_matt_things_are_none(toys: dict[str, Scene], kind: str) -> None:
    assert max(shares(toys[kind])) < 0.01


def test_nothing_is_seen_through_where_normals_are_far_off(toys: dict[str, Scene]) -> None:
    found = prior_of(worst(toys["chrome_room"], "normals_turned"))  # by 30° more
    assert (found.seen_through, found.maybe_seen_through) == ({}, {})


def test_what_surely_is_seen_through_maybe_is(toys: dict[str, Scene]) -> None:
    scene = toys["facing_mirrors"]
    found = prior_of(scene)
    sure, likely = found.seen_through, found.maybe_seen_through
    assert share_of(likely, len(scene.train)) >= MAYBE_SEEN_THROUGH
    assert share_of(likely, len(scene.train)) > share_of(sure, len(scene.train)) >= SEEN_THROUGH
    assert all((likely[name] | ~where).all() for name, where in sure.items())


def test_pixels_lie_in_the_cells_that_their_centers_lie_in() -> None:
    cells = torch.zeros(CELLS, CELLS, dtype=torch.bool)
    cells[3, 5] = True
    where = pixels_in(cells, 4 * CELLS, 2 * CELLS)
    assert torch.equal(where.nonzero().amin(dim=0), torch.tensor([12, 10]))
    assert torch.equal(where.nonzero().amax(dim=0), torch.tensor([15, 11]))


def test_a_view_without_neighbors_tells_of_none(toys: dict[str, Scene]) -> None:
    lone = toys["facing_mirrors"].train[:2]  # each has one
    assert seen_through(lone, 0.2, 40.0, CPU) == SeenThrough()


def test_what_lies_behind_a_camera_is_not_shown(toys: dict[str, Scene]) -> None:
    view = SweptView.of(toys["chrome_room"].train[0], CPU)
    center, ahead = view.camera.center, view.camera.world_to_camera[2, :3]
    assert view.colors(torch.stack([center + ahead, center - ahead])).isnan().any(dim=-1).tolist() == [False, True]
    _, inside = view.colors_along(center, ahead[None, None], torch.tensor([[1.0, -1.0]]))
    assert (inside > 0).flatten().tolist() == [True, False]
