"""Flat mirrors that show rooms behind them are told from what has the normals that it is given."""

from __future__ import annotations

import pytest
import torch
from toy_scenes import coarse_toys, worst

from envgs_bench.core import Scene
from envgs_bench.datasets import load_scene
from envgs_bench.methods.start.evidence import CELLS
from envgs_bench.methods.start.mending import LIKELY_WINDOWS, WINDOWS, mended
from envgs_bench.methods.start.windows import Windows, inside, outside, share_of, windows

NEAR = 0.2
CPU = torch.device("cpu")
TOY = {"kind": "toy", "width": 96, "height": 72, "views": 33, "supersampling": 2, "normal_noise": 5.0}


@pytest.fixture(scope="module")
def toys(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Scene]:
    with coarse_toys():
        kinds = ("facing_mirrors", "chrome_room", "diffuse_room")
        return {kind: load_scene(TOY | {"scene": kind}, tmp_path_factory.mktemp("cache")) for kind in kinds}


def shares(scene: Scene) -> tuple[float, float]:
    """Of what reflects in the training views, and of all else, how much is taken for windows."""
    found = windows(scene.train, 0.1 * scene.radius, 20 * scene.radius, CPU).sure
    counts = torch.zeros(2, 2)  # what reflects or not; in windows, and in all
    for view in scene.train:
        assert view.normal is not None
        known = view.normal.any(dim=-1)
        left = outside(view.normal, found.get(view.name, torch.zeros(CELLS, CELLS, dtype=torch.bool))).any(dim=-1)
        reflects = view.masks.get("reflective", torch.zeros_like(known))
        for row, where in enumerate((reflects & known, ~reflects & known)):
            counts[row] += torch.stack([(where & ~left).sum(), where.sum()])
    windowed, all_of_it = counts.unbind(dim=1)
    return tuple((windowed / all_of_it.clamp_min(1)).tolist())


def test_flat_mirrors_are_windows_and_walls_are_none(toys: dict[str, Scene]) -> None:
    mirrors, walls = shares(toys["facing_mirrors"])
    assert mirrors > 0.35
    assert walls < 0.03


@pytest.mark.parametrize("kind", ["chrome_room", "diffuse_room"])
def test_curved_mirrors_and_matt_things_are_none(toys: dict[str, Scene], kind: str) -> None:
    assert max(shares(toys[kind])) < 0.01


def test_normals_that_are_far_off_make_no_windows(toys: dict[str, Scene]) -> None:
    turned = worst(toys["chrome_room"], "normals_turned")  # by 30° more
    assert mended(turned, NEAR, True, torch.Generator().manual_seed(0), CPU).windows == Windows()


def test_what_is_surely_a_window_is_likely_one(toys: dict[str, Scene]) -> None:
    scene = toys["facing_mirrors"]
    found = mended(scene, NEAR, True, torch.Generator().manual_seed(0), CPU)
    sure, likely = found.windows.sure, found.windows.likely
    assert share_of(likely, len(scene.train)) >= LIKELY_WINDOWS
    assert share_of(likely, len(scene.train)) > share_of(sure, len(scene.train)) >= WINDOWS
    assert all((likely[name] | ~where).all() for name, where in sure.items())
    assert found.views.windows == {}  # a method decides which it goes by


def test_normals_in_windows_are_left_out_and_no_others(toys: dict[str, Scene]) -> None:
    scene = toys["facing_mirrors"]
    before = mended(scene, NEAR, True, torch.Generator().manual_seed(0), CPU)
    found = before.outside_sure_windows()
    cells = found.views.windows
    assert cells == before.windows.sure
    assert "learns no normals" in found.notes[-1]
    for view in scene.train:
        given, learned = before.views(view).normal, found.views(view).normal
        where = inside(cells.get(view.name, torch.zeros(CELLS, CELLS, dtype=torch.bool)), TOY["height"], TOY["width"])
        assert not learned[where].any()
        assert torch.equal(learned[~where], given[~where])


def test_without_windows_nothing_is_left_out_or_said(toys: dict[str, Scene]) -> None:
    found = mended(toys["chrome_room"], NEAR, True, torch.Generator().manual_seed(0), CPU)
    assert found.outside_sure_windows() is found


def test_pixels_lie_in_the_cells_that_their_centers_lie_in() -> None:
    cells = torch.zeros(CELLS, CELLS, dtype=torch.bool)
    cells[3, 5] = True
    where = inside(cells, 4 * CELLS, 2 * CELLS)
    assert torch.equal(where.nonzero().amin(dim=0), torch.tensor([12, 10]))
    assert torch.equal(where.nonzero().amax(dim=0), torch.tensor([15, 11]))


def test_a_view_without_neighbors_tells_of_none(toys: dict[str, Scene]) -> None:
    lone = toys["facing_mirrors"].train[:2]  # each has one
    assert windows(lone, 0.2, 40.0, CPU) == Windows()
