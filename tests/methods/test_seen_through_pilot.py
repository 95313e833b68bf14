"""A pilot run of what may lie behind glass: it compares what was not trained on, and a run goes by what it says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from fakes.methods import MeanColor, Settings
from torch import Tensor

from envgs_bench.core import Camera, Rendering, Scene, View
from envgs_bench.core.normal_prior import NormalPrior
from envgs_bench.datasets import load_scene
from envgs_bench.diagnosis.agreed_normals import with_agreed_normals
from envgs_bench.diagnosis.coverage import CELLS
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.method import Budget
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.training import seen_through_pilot as pilot
from envgs_bench.methods.training.pilot_run import SHORTEST_RUN
from envgs_bench.methods.training.resident_views import as_given
from envgs_bench.methods.training.seen_through_pilot import LEAST_GAIN, better_without
from envgs_bench.parts import REFLECTIVE, TRANSMISSIVE
from envgs_bench.testing import tiny_scene

SETTINGS = {"mono_weight": 0.01, "rules": {"normals": "agreed"}}


class Flat(MeanColor):
    """Draws one gray in the upper half and another below, and remembers what it was trained on."""

    def __init__(self, gray: float, elsewhere: float = 0.5) -> None:
        super().__init__(Settings())
        self.gray, self.elsewhere, self.seen = gray, elsewhere, dict[str, View]()

    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        self.scene = scene

    def training_step(self, view: View, step: int) -> dict[str, float]:
        self.seen[view.name] = view
        return super().training_step(view, step)

    def render(self, camera: Camera) -> Rendering:
        color = torch.full((camera.height, camera.width, 3), self.elsewhere)
        color[: camera.height // 2] = self.gray
        return replace(super().render(camera), color=color)


def upper_half() -> Tensor:
    cells = torch.zeros(CELLS, CELLS, dtype=torch.bool)
    cells[: CELLS // 2] = True
    return cells


def black_views(count: int) -> Scene:
    scene = tiny_scene()
    first = replace(scene.train[0], image=torch.zeros_like(scene.train[0].image))
    return replace(scene, train=[replace(first, name=f"{index:02d}") for index in range(count)])


def left_out(prior: NormalPrior, held: Flat, free: Flat, views: int = 12) -> dict[str, Tensor]:
    return better_without(black_views(views), prior, held, free)


def test_what_is_drawn_better_without_normals_is_left_out_where_some_views_see_through_it() -> None:
    everywhere = torch.ones(CELLS, CELLS, dtype=torch.bool)
    held, above, below = Flat(0.2, elsewhere=0.9), Flat(0.1, elsewhere=0.9), Flat(0.2, elsewhere=0.45)
    for free, expected in ((above, upper_half()), (below, ~upper_half())):
        one_of_twelve = NormalPrior(as_given, maybe_seen_through={"03": everywhere})
        cells = left_out(one_of_twelve, held, free)
        assert set(cells) == {f"{index:02d}" for index in range(12)}
        assert all(torch.equal(where, expected) for where in cells.values())
    elsewhere = NormalPrior(as_given, maybe_seen_through={"03": ~upper_half()})
    assert left_out(elsewhere, held, above) == {}
    assert left_out(NormalPrior(as_given, maybe_seen_through={"03": everywhere}), held, above, views=24) == {}


def test_one_learns_all_normals_and_one_none_and_views_are_held_out() -> None:
    held, free = Flat(0.2), Flat(0.2)
    assert left_out(NormalPrior(as_given, maybe_seen_through={"03": upper_half()}), held, free) == {}
    for method, normals in ((held, True), (free, False)):
        assert len(method.scene.train) == 11
        assert "04" not in method.seen
        assert all(view.normal is not None and bool(view.normal.any()) is normals for view in method.seen.values())


@pytest.mark.parametrize(("gain", "enough"), [(LEAST_GAIN - 0.05, False), (LEAST_GAIN + 0.05, True), (-3.0, False)])
def test_by_so_much_it_must_be_better(gain: float, enough: bool) -> None:
    everywhere = NormalPrior(as_given, maybe_seen_through={"03": torch.ones(CELLS, CELLS, dtype=torch.bool)})
    gray = 0.2 * 10 ** (-gain / 20)
    cells = left_out(everywhere, Flat(0.2, 0.2), Flat(gray, gray))
    assert all(where.all() for where in cells.values())
    assert len(cells) == (12 if enough else 0)


def scene_with_prior() -> Scene:
    """The upper half of the tiny scene's views may be seen through glass, a quarter of them surely is."""
    scene = tiny_scene()
    likely = {view.name: upper_half() for view in scene.train}
    sure = {name: cells & upper_half().T for name, cells in likely.items()}
    return replace(scene, normals=NormalPrior(as_given, 1.0, sure, likely, ["first"]))


def tells(monkeypatch: pytest.MonkeyPatch, cells: Tensor | None) -> list[tuple[GaussianMethod, ...]]:
    """Pilot runs find these cells in every view from now on; the methods that they are given."""
    given = []

    def found(scene: Scene, prior: NormalPrior, *methods: GaussianMethod) -> dict[str, Tensor]:
        given.append(methods)
        return {} if cells is None else {view.name: cells for view in scene.train}

    monkeypatch.setattr(pilot, "better_without", found)
    return given


def learned(method: GaussianMethod) -> Tensor:
    """Which pixels' normals the first training view is learned with."""
    normal = method.runner.views.on_device(tiny_scene().train[0]).normal
    assert normal is not None
    return normal.any(dim=-1)


def share_of_normals(method: GaussianMethod) -> float:
    given = tiny_scene().train[0].normal
    assert given is not None
    return float(learned(method).sum() / given.any(dim=-1).sum())


@pytest.mark.parametrize("kind", ["envgs", "envmap", "2dgs"])
@pytest.mark.parametrize(("left_out", "share"), [(True, 0.5), (False, 1.0)])
def test_a_long_run_goes_by_the_pilot_run(
    kind: str, left_out: bool, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = tells(monkeypatch, upper_half() if left_out else None)
    method = create_method(kind, SETTINGS, seed=3)
    assert isinstance(method, GaussianMethod)
    before = method.generator.get_state()
    method.initialize(scene_with_prior(), SHORTEST_RUN)
    assert share_of_normals(method) == pytest.approx(share, abs=0.1)
    assert method.notes[0] == "first"
    assert f"{1 - share:.0%} of what the training views show" in method.notes[1]
    ((held, free),) = given
    assert type(held) is type(free) is type(method)
    assert held.settings == free.settings == method.settings.ruled(normals="as_given")
    assert held.generator.initial_seed() == free.generator.initial_seed() == 3
    assert held.generator is not method.generator
    assert torch.equal(held.generator.get_state(), before)


def test_a_pilot_run_that_refuses_leaves_a_run_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    tells(monkeypatch, None)
    scene, methods = scene_with_prior(), [create_method("envgs", SETTINGS, seed=1) for _ in range(2)]
    methods[0].initialize(scene, SHORTEST_RUN)
    methods[1].initialize(tiny_scene(), SHORTEST_RUN)
    for method in methods:
        for step in (1, 2, 3):
            method.training_step(scene.train[step], step)
    drawn = [method.render(scene.test[0].camera).color for method in methods]
    assert torch.equal(*drawn)


def test_a_short_run_goes_by_what_is_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    given = tells(monkeypatch, upper_half())
    method = create_method("envgs", SETTINGS)
    assert isinstance(method, GaussianMethod)
    method.initialize(scene_with_prior(), SHORTEST_RUN - 1)
    assert given == []
    assert share_of_normals(method) == pytest.approx(0.75, abs=0.1)
    assert "learns no normals from 25%" in method.notes[1]


def test_an_interrupted_run_is_tried_once_and_within_its_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    given = tells(monkeypatch, upper_half())
    first, second = (create_method("envgs", SETTINGS, seed=1) for _ in range(2))
    assert isinstance(first, GaussianMethod)
    assert isinstance(second, GaussianMethod)
    for method in (first, second):
        method.limit(Budget(primitives=400))
    first.initialize(scene_with_prior(), SHORTEST_RUN)
    second.resume(scene_with_prior(), SHORTEST_RUN, first.training_state())
    assert len(given) == 1
    assert all(method.model.budget is not None for method in given[0])
    assert second.notes == first.notes
    assert torch.equal(learned(second), learned(first))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "region", "least", "most"), [("glass", TRANSMISSIVE, 0.4, 0.9), ("wavy_mirror", REFLECTIVE, 0.0, 0.1)]
)
def test_panes_lose_their_normals_and_curved_mirrors_keep_them(
    kind: str, region: str, least: float, most: float, tmp_path: Path
) -> None:
    toy = {"kind": "toy", "scene": kind, "width": 96, "height": 72, "normal_noise": 5.0}
    scene = with_agreed_normals(Diagnosis(load_scene(toy, tmp_path)))
    method = create_method("envgs")
    assert isinstance(method, GaussianMethod)
    method.initialize(scene, SHORTEST_RUN)
    inside = lost = 0
    for view in scene.train:
        normal = method.runner.views.on_device(view).normal
        assert normal is not None
        inside += int(view.masks[region].sum())
        lost += int((view.masks[region] & ~normal.any(dim=-1)).sum())
    assert least <= lost / inside <= most
