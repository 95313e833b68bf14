"""The lean methods: each beside what it is pruned from, and no worse for being smaller."""

from __future__ import annotations

from typing import Any

import pytest
from fakes.runs import set_environment
from sweeps import one_run
from toy_scenes import coarse_toys

from envgs_bench.core import Scene
from envgs_bench.datasets import load_scene
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.training.losses import training_psnr
from envgs_bench.stages.training import shuffled

FULL = {"2dgs_lean": "2dgs_tuned", "3dgs_lean": "3dgs_tuned", "envgs_lean": "envgs"}
TOY = {"kind": "toy", "scene": "chrome_room", "width": 64, "height": 48, "views": 32, "supersampling": 1}
STEPS = 600


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


@pytest.mark.parametrize("lean", FULL)
def test_a_lean_method_is_the_full_one_but_for_prunings_and_a_trial(lean: str) -> None:
    small, full = (one_run("scores", method=name).method for name in (lean, FULL[lean]))
    assert (small.name, small.kind) == (lean, full.kind)
    differences = {key for key, value in full.settings.items() if small.settings[key] != value}
    assert differences == {"prune_error"} | ({"reflection_pilot"} if lean == "envgs_lean" else set())


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    with coarse_toys():
        return load_scene(TOY, tmp_path_factory.mktemp("cache"))


@pytest.mark.slow
@pytest.mark.parametrize(("lean", "lost"), [("2dgs_lean", 0.3), ("3dgs_lean", 0.3)])
def test_two_thirds_of_the_primitives_draw_a_small_room_nearly_as_well(lean: str, lost: float, room: Scene) -> None:
    """By at most so many dB of test views' mean PSNR. Drawn with one ray a pixel, it has edges that look like noise."""
    (full, most), (small, count) = (_trained(name, room) for name in (FULL[lean], lean))
    assert count < 2 * most / 3
    assert small > full - lost


def _trained(name: str, scene: Scene) -> tuple[float, int]:
    chosen: Any = one_run("scores", method=name).method
    method = create_method(chosen.kind, chosen.settings, seed=0)
    method.initialize(scene, STEPS)
    for step, view in enumerate(shuffled(scene.train, STEPS, seed=0), 1):
        method.training_step(view, step)
    scores = [float(training_psnr(method.render(v.camera).color, v.rgb(method.device))) for v in scene.test]
    return sum(scores) / len(scores), sum(method.primitives().values())
