"""What `envgs-bench view` draws for a browser, without one: against the pictures that a run leaves."""

from __future__ import annotations

import sys
import threading
import time
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from fakes.runs import set_environment
from trained_runs import trained_run

from envgs_bench.cli.main import main
from envgs_bench.core import Camera
from envgs_bench.methods.storage.layouts import LAYOUTS
from envgs_bench.run_folder import layer_path, read_png, render_path
from envgs_bench.stages.pictures import save_view
from envgs_bench.testing import HEIGHT, WIDTH
from envgs_bench.viewing.look import ERROR, PHOTOGRAPH, Look, Side, columns, layers_of, photograph_in, view_at
from envgs_bench.viewing.opened import OpenedRun, open_runs
from envgs_bench.viewing.resolution import LEAST_PIXELS, MOVING_SECONDS, Resolution
from envgs_bench.viewing.viewer import Viewer, Window, eye_of

FULL = (WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        set_environment(patch)
        for kind in ("envgs", "2dgs"):
            trained_run(found / kind, kind)
    return found


@pytest.fixture(scope="module")
def runs(folder: Path) -> list[OpenedRun]:
    with pytest.MonkeyPatch.context() as patch:
        set_environment(patch)
        return open_runs([folder / "envgs", folder / "2dgs"], "cpu")


@pytest.mark.parametrize("layout", ["ply", "spz", "sog"])
def test_a_file_of_gaussians_is_seen_beside_a_run_as_the_run_that_wrote_it(
    tmp_path: Path, folder: Path, runs: list[OpenedRun], layout: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_environment(monkeypatch)
    (written,) = LAYOUTS[layout].write(runs[1].method, tmp_path)  # type: ignore[arg-type]
    file, run = open_runs([written, folder / "2dgs"], "cpu")
    assert file.label == written.name
    camera = run.views[0].camera
    theirs, ours = (Look(camera, Side(each, "image")).picture(FULL).astype(int) for each in (file, run))
    assert np.abs(theirs - ours).mean() < (0.01 if layout == "ply" else 10)  # flat 3D Gaussians
    with pytest.raises(ValueError, match="says nothing of cameras; give a run of its scene too"):
        open_runs([written], "cpu")


def test_at_a_test_camera_every_layer_is_the_picture_that_the_run_leaves(tmp_path: Path, runs: list[OpenedRun]) -> None:
    run, view = runs[0], runs[0].views[1]
    save_view(tmp_path, view, run.method.render(view.camera), run.depth_unit)
    layers = layers_of(run)
    assert layers == ["image", "base", "reflection", "beta", "normal", "depth", PHOTOGRAPH, ERROR]
    for layer in layers:
        path = render_path(tmp_path, view.name) if layer == "image" else layer_path(tmp_path, view.name, layer)
        expected = view.image.numpy() if layer == PHOTOGRAPH else read_png(path)
        assert np.array_equal(Look(view.camera, Side(run, layer)).picture(FULL), expected), layer


def test_two_halves_are_the_columns_of_two_pictures(runs: list[OpenedRun]) -> None:
    camera = runs[0].views[0].camera
    sides = [Side(run, "image") for run in runs]
    left, right = (Look(camera, side).picture(FULL) for side in sides)
    assert not np.array_equal(left, right)
    both = Look(camera, *sides, divide=0.25).picture(FULL)
    assert np.array_equal(both[:, :8], left[:, :8])
    assert np.array_equal(both[:, 8:], right[:, 8:])
    for divide in (0.0, 1.0):
        assert Look(camera, *sides, divide=divide).picture(FULL).shape == left.shape


def test_halves_of_a_large_picture_have_their_names_at_the_bottom(runs: list[OpenedRun]) -> None:
    camera = runs[0].views[0].camera
    both = Look(camera, *(Side(run, "depth") for run in runs)).picture((320, 240))
    assert np.ptp(both[-12:, 130:190].astype(int), axis=(0, 1)).min() > 200  # white on black beside the divide


def test_away_from_photographs_an_error_is_the_picture_and_says_so(runs: list[OpenedRun]) -> None:
    run = runs[0]
    away = replace(run.views[0].camera, world_to_camera=turned(run.views[0].camera, 2.0))
    assert np.array_equal(Look(away, Side(run, ERROR)).picture(FULL), Look(away, Side(run, "image")).picture(FULL))


def turned(camera: Camera, degrees: float) -> torch.Tensor:
    """The camera's pose, turned about its own axis."""
    angle = torch.deg2rad(torch.tensor(degrees))
    turn = torch.eye(4)
    turn[:2, :2] = torch.tensor([[angle.cos(), -angle.sin()], [angle.sin(), angle.cos()]])
    return turn @ camera.world_to_camera


def test_a_view_is_found_where_it_was_taken_only(runs: list[OpenedRun]) -> None:
    run = runs[0]
    camera = run.views[1].camera
    assert view_at(run, camera) is run.views[1]
    assert view_at(run, replace(camera, world_to_camera=turned(camera, 0.05))) is run.views[1]
    assert view_at(run, replace(camera, world_to_camera=turned(camera, 0.2))) is None
    aside = camera.world_to_camera.clone()
    aside[0, 3] += 0.01 * run.scene.radius
    assert view_at(run, replace(camera, world_to_camera=aside)) is None


def test_a_photograph_stands_in_the_middle_of_a_wider_window(runs: list[OpenedRun]) -> None:
    view = runs[0].views[0]
    photograph = view.rgb()
    window = eye_of(view.camera, 2 * WIDTH, HEIGHT).camera(most_rows=1000)
    seen, there = photograph_in(view, window)
    assert torch.allclose(seen[:, WIDTH // 2 : -WIDTH // 2], photograph, atol=1e-4)
    assert there[:, WIDTH // 2 : -WIDTH // 2].all()
    assert int(there.sum()) == WIDTH * HEIGHT
    half, _ = photograph_in(view, view.camera.resized(WIDTH // 2, HEIGHT // 2))
    means = photograph.reshape(HEIGHT // 2, 2, WIDTH // 2, 2, 3).mean((1, 3))
    assert (half - means).abs().mean() < 0.02


def test_columns_of_a_camera_see_what_they_did(runs: list[OpenedRun]) -> None:
    camera = runs[0].views[0].camera
    part = columns(camera, 10, 25)
    assert (part.width, part.height) == (15, HEIGHT)
    for ours, theirs in zip(part.rays(), camera.rays(), strict=True):
        assert torch.allclose(ours, theirs[:, 10:25], atol=1e-6)


def test_a_browsers_camera_sees_what_the_view_does(runs: list[OpenedRun]) -> None:
    camera = runs[0].views[1].camera
    again = eye_of(camera, WIDTH, HEIGHT).camera(most_rows=HEIGHT)
    assert torch.allclose(again.world_to_camera, camera.world_to_camera, atol=1e-6)
    assert torch.allclose(again.intrinsics, camera.intrinsics, atol=1e-4)
    large = eye_of(camera, 1600, 900).camera(most_rows=300)
    assert (large.width, large.height) == (533, 300)
    assert float(large.intrinsics[1, 1] / 300) == pytest.approx(float(camera.intrinsics[1, 1]) / HEIGHT)


def test_moving_frames_take_a_tenth_of_a_second_and_still_ones_grow_to_the_full_size() -> None:
    full, resolution = (1280, 720), Resolution()
    seconds_a_pixel = 3e-6
    for _ in range(12):
        width, height = resolution.moving(full)
        resolution.drew((width, height), seconds_a_pixel * width * height)
    taken = seconds_a_pixel * width * height
    assert taken == pytest.approx(MOVING_SECONDS, rel=0.02)
    assert width / height == pytest.approx(16 / 9, rel=0.02)
    sizes = [(width, height)]
    while (size := resolution.still(full, sizes[-1])) is not None:
        sizes.append(size)
    assert [after[0] / before[0] for before, after in pairwise(sizes[:-1])] == pytest.approx([2.0] * (len(sizes) - 2))
    assert sizes[-1] == full
    for _ in range(12):
        resolution.drew(full, 1e-3)
    assert resolution.moving(full) == full  # on a device that is quick enough
    slow = Resolution()
    slow.drew((100, 100), 50.0)
    width, height = slow.moving((160, 120))
    assert width * height == pytest.approx(LEAST_PIXELS, rel=0.05)


class Control:
    """What viser gives back for a control: it has a value and tells who asked to be told."""

    def __init__(self, value: Any) -> None:
        self._value, self._told, self.options, self.content, self.visible = value, [], [], "", True

    @property
    def value(self) -> Any:
        return self._value

    @value.setter
    def value(self, value: Any) -> None:
        changed, self._value = value != self._value, value
        for told in self._told if changed else []:
            told(None)

    def on_update(self, told: Any) -> None:
        self._told.append(told)

    on_click = on_update


@dataclass
class Browser:
    """A stand-in for viser's client: remembers the pictures that it is sent."""

    pictures: list[np.ndarray] = field(default_factory=list)
    came: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        self.client_id, self.frusta = 0, {}
        self.camera = SimpleNamespace(fov=1.0, image_width=96, image_height=72, on_update=lambda told: None)
        self.gui = SimpleNamespace(
            add_markdown=lambda text: Control(text),
            add_dropdown=lambda label, options, initial_value=None: Control(initial_value or options[0]),
            add_slider=lambda label, low, high, step, value: Control(value),
            add_checkbox=lambda label, value: Control(value),
            add_folder=lambda label: nullcontext(),
        )
        self.scene = SimpleNamespace(add_camera_frustum=self._add, set_background_image=self._show)

    def atomic(self) -> Any:
        return nullcontext()

    def _add(self, name: str, *_: Any, **__: Any) -> Control:
        return self.frusta.setdefault(name, Control(None))

    def _show(self, picture: np.ndarray, **_: Any) -> None:
        self.pictures.append(picture)
        self.came.set()

    def await_size(self, width: int) -> np.ndarray:
        """The next picture of that width."""
        ends = time.monotonic() + 60
        while time.monotonic() < ends:
            self.came.wait(1)
            self.came.clear()
            if self.pictures and self.pictures[-1].shape[1] == width:
                return self.pictures[-1]
        raise AssertionError(f"no picture {width} pixels wide, only {[p.shape for p in self.pictures]}")


def test_a_browser_gets_coarse_pictures_then_the_whole_one_of_what_it_chose(runs: list[OpenedRun]) -> None:
    browser, run = Browser(), runs[0]
    window = Window(Viewer(runs, most_rows=48), browser, {run.label: layers_of(run) for run in runs})
    window.right_run.value = "nothing"
    window.resolution.drew((64, 48), 100.0)  # a slow machine: moving frames are as coarse as they get
    window.start()
    try:
        whole = browser.await_size(64)
        assert browser.pictures[0].shape[1] < 64 or len(browser.pictures) == 1
        view = run.views[0]
        assert np.array_equal(whole, Look(window.look().camera, Side(run, "image")).picture((64, 48)))
        assert view_at(run, window.look().camera) is view
        assert [name for name, frustum in browser.frusta.items() if not frustum.visible] == [
            f"/test cameras/{view.name}"
        ]
        assert "primitives" in window.told.content
        assert window.told.content.startswith("64 × 48 pixels")
        browser.pictures.clear()
        window.left_layer.value = "normal"
        shown = browser.await_size(64)
        assert np.array_equal(shown, Look(window.look().camera, Side(run, "normal")).picture((64, 48)))
        window.test_camera.value = run.views[1].name
        assert view_at(run, window.look().camera) is run.views[1]
        window.left_layer.value = "beta"
        window.left_run.value = runs[1].label  # which draws no β
        assert window.look().left == Side(runs[1], "image")
    finally:
        window.close()
        window.join(20)
    assert not window.is_alive()


def test_without_viser_it_says_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", str(tmp_path)]) == 1
    assert "pip install 'envgs-bench[view]'" in capsys.readouterr().err


def test_labels_tell_runs_apart_and_scenes_must_be_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)
    for name in "ab":
        trained_run(tmp_path / name, "2dgs", steps=1)
    first, second = open_runs([tmp_path / "a", tmp_path / "b"], "cpu")
    assert (first.label, second.label) == ("2dgs, seed 0 (1)", "2dgs, seed 0 (2)")
    config = (tmp_path / "b" / "config.yaml").read_text()
    (tmp_path / "b" / "config.yaml").write_text(config.replace("fakes.datasets:tiny", "fakes.datasets:tiny_elsewhere"))
    with pytest.raises(ValueError, match="with other test cameras; give runs of one scene"):
        open_runs([tmp_path / "a", tmp_path / "b"], "cpu")
