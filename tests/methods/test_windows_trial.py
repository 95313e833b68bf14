"""A trial of windows: it compares what was not trained on, where windows may be, and a run goes by what it says."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from fakes.methods import MeanColor, Settings
from torch import Tensor

from envgs_bench.core import Camera, Rendering, Scene, View
from envgs_bench.datasets import load_scene
from envgs_bench.methods import gaussian_method
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.gaussians.budget import Budget
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.start.evidence import CELLS
from envgs_bench.methods.start.mending import Mended
from envgs_bench.methods.start.windows import Windows
from envgs_bench.methods.training.pilot_run import SHORTEST_RUN
from envgs_bench.methods.windows_trial import LEAST_GAIN, WindowsOutcome, windows_trial
from envgs_bench.testing import tiny_scene

SETTINGS = {"mono_weight": 0.01, "mends_input": True}


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


def test_what_was_held_out_is_compared_inside_likely_windows() -> None:
    scene = twelve_black_views()
    likely = {view.name: upper_half() for view in scene.train}
    found = Mended(scene, windows=Windows(likely=likely))
    held, free = Flat(0.2, elsewhere=0.9), Flat(0.1, elsewhere=0.3)
    outcome = windows_trial(found, held, free)
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
    found = Mended(scene, windows=Windows(likely={"03": upper_half()}))
    assert windows_trial(found, Flat(0.2), Flat(0.1)).gain == 0


@pytest.mark.parametrize("gain", [-1.0, LEAST_GAIN - 0.01, LEAST_GAIN + 0.01, math.nan])
def test_windows_are_what_is_drawn_better_without_normals(gain: float) -> None:
    outcome = WindowsOutcome(0.25, gain)
    assert outcome.lies_behind is (gain > LEAST_GAIN)
    assert "25%" in outcome.sentence
    assert f"{gain:+.2f} dB" in outcome.sentence
    assert ("no normals are learned" in outcome.sentence) is outcome.lies_behind


@pytest.fixture
def window(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """What the tiny scene shows in the upper half of its views may be windows, in a quarter of them it surely is."""
    likely = {view.name: upper_half() for view in tiny_scene().train}
    sure = {name: cells & upper_half().T for name, cells in likely.items()}
    monkeypatch.setattr(
        gaussian_method, "mended", lambda scene, *_: Mended(scene, notes=["first"], windows=Windows(sure, likely))
    )
    return monkeypatch


def tells(monkeypatch: pytest.MonkeyPatch, gain: float) -> list[tuple[GaussianMethod, ...]]:
    """Trials find this gain from now on; the methods that they are given."""
    given = []

    def found(start: Mended, *methods: GaussianMethod) -> WindowsOutcome:
        given.append(methods)
        return WindowsOutcome(0.5, gain)

    monkeypatch.setattr(gaussian_method, "windows_trial", found)
    return given


def learned(method: GaussianMethod) -> Tensor:
    """Which pixels' normals the first training view is learned with."""
    normal = method._views.on_device(tiny_scene().train[0]).normal
    assert normal is not None
    return normal.any(dim=-1)


def share_of_normals(method: GaussianMethod) -> float:
    given = tiny_scene().train[0].normal
    assert given is not None
    return float(learned(method).sum() / given.any(dim=-1).sum())


@pytest.mark.parametrize("kind", ["envgs", "envmap", "2dgs"])
@pytest.mark.parametrize(("gain", "share"), [(LEAST_GAIN + 1, 0.5), (LEAST_GAIN - 1, 1.0)])
def test_a_long_run_goes_by_the_trial(kind: str, gain: float, share: float, window: pytest.MonkeyPatch) -> None:
    given = tells(window, gain)
    method = create_method(kind, SETTINGS, seed=3)
    assert isinstance(method, GaussianMethod)
    before = method.generator.get_state()
    method.initialize(tiny_scene(), SHORTEST_RUN)
    assert share_of_normals(method) == pytest.approx(share, abs=0.1)
    assert method.mended[:2] == ["first", WindowsOutcome(0.5, gain).sentence]
    ((held, free),) = given
    assert type(held) is type(free) is type(method)
    assert held.settings == free.settings == replace(method.settings, mends_input=False)
    assert held.generator.initial_seed() == free.generator.initial_seed() == 3
    assert held.generator is not method.generator
    assert torch.equal(held.generator.get_state(), before)


def test_a_trial_that_refuses_leaves_a_run_alone(window: pytest.MonkeyPatch) -> None:
    tells(window, LEAST_GAIN - 1)
    scene, methods = tiny_scene(), [create_method("envgs", SETTINGS, seed=1) for _ in range(2)]
    methods[0].initialize(scene, SHORTEST_RUN)
    window.setattr(gaussian_method, "mended", lambda given, *_: Mended(given))
    methods[1].initialize(scene, SHORTEST_RUN)
    for method in methods:
        for step in (1, 2, 3):
            method.training_step(scene.train[step], step)
    drawn = [method.render(scene.test[0].camera).color for method in methods]
    assert torch.equal(*drawn)


def test_a_short_run_goes_by_what_is_sure(window: pytest.MonkeyPatch) -> None:
    given = tells(window, LEAST_GAIN + 1)
    method = create_method("envgs", SETTINGS)
    assert isinstance(method, GaussianMethod)
    method.initialize(tiny_scene(), SHORTEST_RUN - 1)
    assert given == []
    assert share_of_normals(method) == pytest.approx(0.75, abs=0.1)
    assert "learns no normals from 25%" in method.mended[1]


def test_an_interrupted_run_is_tried_once_and_within_its_budget(window: pytest.MonkeyPatch) -> None:
    given = tells(window, LEAST_GAIN + 1)
    first, second = (create_method("envgs", SETTINGS, seed=1) for _ in range(2))
    assert isinstance(first, GaussianMethod)
    assert isinstance(second, GaussianMethod)
    for method in (first, second):
        method.limit(Budget(primitives=400))
    first.initialize(tiny_scene(), SHORTEST_RUN)
    second.resume(tiny_scene(), SHORTEST_RUN, first.training_state())
    assert len(given) == 1
    assert all(method._budget is not None for method in given[0])
    assert second.mended == first.mended
    assert torch.equal(learned(second), learned(first))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "lies_behind"), [("glass", True), ("wavy_mirror", False)])
def test_panes_are_told_from_curved_mirrors(kind: str, lies_behind: bool, tmp_path: Path) -> None:
    toy = {"kind": "toy", "scene": kind, "width": 96, "height": 72, "normal_noise": 5.0}
    method = create_method("envgs")
    method.initialize(load_scene(toy, tmp_path), SHORTEST_RUN)
    (said,) = (note for note in method.mended if "trial" in note)
    assert ("no normals are learned" in said) is lies_behind
