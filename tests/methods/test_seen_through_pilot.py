"""A pilot run of what may lie behind glass: it compares what was not trained on, and a run goes by what it says."""

from __future__ import annotations

import math
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
from envgs_bench.methods.training.seen_through_pilot import LEAST_GAIN, SeenThroughOutcome, seen_through_pilot
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


def twelve_black_views() -> Scene:
    scene = tiny_scene()
    first = replace(scene.train[0], image=torch.zeros_like(scene.train[0].image))
    return replace(scene, train=[replace(first, name=f"{index:02d}") for index in range(12)])


def test_what_was_held_out_is_compared_where_it_may_lie_behind() -> None:
    scene = twelve_black_views()
    likely = {view.name: upper_half() for view in scene.train}
    prior = NormalPrior(as_given, maybe_seen_through=likely)
    held, free = Flat(0.2, elsewhere=0.9), Flat(0.1, elsewhere=0.3)
    outcome = seen_through_pilot(scene, prior, held, free)
    assert outcome.gain == pytest.approx(20 * math.log10(2), abs=1e-4)
    assert outcome.share == pytest.approx(0.5)
    for method, without in ((held, False), (free, True)):
        assert len(method.scene.train) == 11
        assert "04" not in method.seen
        for view in method.seen.values():
            assert view.normal is not None
            middle = view.normal.shape[0] // 2
            assert bool(view.normal[:middle].any()) is not without
            assert view.normal[middle:].any()


def test_where_no_view_held_out_shows_any_nothing_is_gained() -> None:
    scene = twelve_black_views()
    prior = NormalPrior(as_given, maybe_seen_through={"03": upper_half()})
    assert seen_through_pilot(scene, prior, Flat(0.2), Flat(0.1)).gain == 0


@pytest.mark.parametrize("gain", [-1.0, LEAST_GAIN - 0.01, LEAST_GAIN + 0.01, math.nan])
def test_what_is_drawn_better_without_normals_lies_behind_them(gain: float) -> None:
    outcome = SeenThroughOutcome(0.25, gain)
    assert outcome.lies_behind is (gain > LEAST_GAIN)
    assert "25%" in outcome.sentence
    assert f"{gain:+.2f} dB" in outcome.sentence
    assert ("no normals are learned" in outcome.sentence) is outcome.lies_behind


def scene_with_prior() -> Scene:
    """The upper half of the tiny scene's views may be seen through glass, a quarter of them surely is."""
    scene = tiny_scene()
    likely = {view.name: upper_half() for view in scene.train}
    sure = {name: cells & upper_half().T for name, cells in likely.items()}
    return replace(scene, normals=NormalPrior(as_given, 1.0, sure, likely, ["first"]))


def tells(monkeypatch: pytest.MonkeyPatch, gain: float) -> list[tuple[GaussianMethod, ...]]:
    """Pilot runs find this gain from now on; the methods that they are given."""
    given = []

    def found(scene: Scene, prior: NormalPrior, *methods: GaussianMethod) -> SeenThroughOutcome:
        given.append(methods)
        return SeenThroughOutcome(0.5, gain)

    monkeypatch.setattr(pilot, "seen_through_pilot", found)
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
@pytest.mark.parametrize(("gain", "share"), [(LEAST_GAIN + 1, 0.5), (LEAST_GAIN - 1, 1.0)])
def test_a_long_run_goes_by_the_pilot_run(
    kind: str, gain: float, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = tells(monkeypatch, gain)
    method = create_method(kind, SETTINGS, seed=3)
    assert isinstance(method, GaussianMethod)
    before = method.generator.get_state()
    method.initialize(scene_with_prior(), SHORTEST_RUN)
    assert share_of_normals(method) == pytest.approx(share, abs=0.1)
    assert method.notes[:2] == ["first", SeenThroughOutcome(0.5, gain).sentence]
    ((held, free),) = given
    assert type(held) is type(free) is type(method)
    assert held.settings == free.settings == method.settings.ruled(normals="as_given")
    assert held.generator.initial_seed() == free.generator.initial_seed() == 3
    assert held.generator is not method.generator
    assert torch.equal(held.generator.get_state(), before)


def test_a_pilot_run_that_refuses_leaves_a_run_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    tells(monkeypatch, LEAST_GAIN - 1)
    scene, methods = scene_with_prior(), [create_method("envgs", SETTINGS, seed=1) for _ in range(2)]
    methods[0].initialize(scene, SHORTEST_RUN)
    methods[1].initialize(tiny_scene(), SHORTEST_RUN)
    for method in methods:
        for step in (1, 2, 3):
            method.training_step(scene.train[step], step)
    drawn = [method.render(scene.test[0].camera).color for method in methods]
    assert torch.equal(*drawn)


def test_a_short_run_goes_by_what_is_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    given = tells(monkeypatch, LEAST_GAIN + 1)
    method = create_method("envgs", SETTINGS)
    assert isinstance(method, GaussianMethod)
    method.initialize(scene_with_prior(), SHORTEST_RUN - 1)
    assert given == []
    assert share_of_normals(method) == pytest.approx(0.75, abs=0.1)
    assert "learns no normals from 25%" in method.notes[1]


def test_an_interrupted_run_is_tried_once_and_within_its_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    given = tells(monkeypatch, LEAST_GAIN + 1)
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
@pytest.mark.parametrize(("kind", "lies_behind"), [("glass", True), ("wavy_mirror", False)])
def test_panes_are_told_from_curved_mirrors(kind: str, lies_behind: bool, tmp_path: Path) -> None:
    toy = {"kind": "toy", "scene": kind, "width": 96, "height": 72, "normal_noise": 5.0}
    method = create_method("envgs")
    method.initialize(with_agreed_normals(Diagnosis(load_scene(toy, tmp_path))), SHORTEST_RUN)
    (said,) = (note for note in method.notes if "pilot run" in note)
    assert ("no normals are learned" in said) is lies_behind
