"""The cheapest form of each case of the stability study: methods learn the scene, and say so where they do not."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from toy_scenes import coarse_toys, worst

from envgs_bench.core import Scene
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS
from envgs_bench.diagnosis.agreed_normals import with_agreed_normals
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.diagnosis.repair import REPAIRS, repaired
from envgs_bench.methods.method import Method
from envgs_bench.methods.registry import create_method
from envgs_bench.stages.training import Training

TOY = {"kind": "toy", "width": 40, "height": 30, "views": 33, "supersampling": 1, "normal_noise": 5.0}
ENVGS = {"env_grid": 5, "env_far_count": 100}
STEPS = 150
SCENES = ("glass", "facing_mirrors", "thin_rails", "sky_ball", "wavy_mirror", "lacquered_table")
FAST = ("facing_mirrors", "views", "points_at_cameras")  # the others are marked slow
LEFT = {  # dB over one color that are left of 150 steps; three views: −0.86 to −1.20, as they are drawn
    "views": -1.4,
    "points_random": -0.05,  # 0.01 to 0.09, of three seeds; where growth is by gradients, −0.06 to 0.00
}
AS_GIVEN = {  # dB, at most, with points as they are given; guided growth makes less of what is near a camera
    "points_at_cameras": {"guided": -4.0, "gradient": -4.0},
    "points_near_cameras": {"guided": -0.5, "gradient": -1.5},
}


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Scene]:
    folder = tmp_path_factory.mktemp("cache")

    @cache
    def load(name: str) -> Scene:
        with coarse_toys():
            return load_scene({**TOY, "scene": name}, folder)

    return load


def repaired_scene(scene: Scene) -> Scene:
    return with_agreed_normals(repaired(Diagnosis(scene), list(REPAIRS))[0])


def cases(names: Iterable[str]) -> list[Any]:
    return [pytest.param(name, marks=() if name in FAST else pytest.mark.slow) for name in names]


def trained(kind: str, scene: Scene, folder: Path, **settings: Any) -> tuple[Method, Training]:
    method = create_method(kind, (ENVGS if kind == "envgs" else {}) | settings)
    training = Training(method, scene, STEPS, seed=0)
    training.run(folder / "curve.csv", lambda event: None)
    method.prepare()
    return method, training


def psnr_on_test_views(method: Method, scene: Scene) -> float:
    pairs = [(method.render(view.camera).color.clamp(0, 1), view.rgb()) for view in scene.test]
    return float(np.mean([-10 * float((a - b).square().mean().log10()) for a, b in pairs]))


def of_one_color(scene: Scene) -> float:
    """The PSNR of test views that are all in the training views' mean color: of a method that learned nothing."""
    color = torch.stack([view.rgb().mean((0, 1)) for view in scene.train]).mean(0)
    return float(np.mean([-10 * float((color - view.rgb()).square().mean().log10()) for view in scene.test]))


def gain(kind: str, scene: Scene, folder: Path, warnings: Sequence[str] = (), **settings: Any) -> float:
    """By how many dB a training, with no other warnings, is better than having learned nothing."""
    method, training = trained(kind, scene, folder, **settings)
    assert [warning.kind for warning in training.health.warnings] == list(warnings)
    assert int(method.skipped_steps) == 0
    return psnr_on_test_views(method, scene) - of_one_color(scene)


@pytest.mark.parametrize("name", cases(SCENES))
def test_scenes_that_break_an_assumption_train_soundly(toy: Callable[[str], Scene], name: str, tmp_path: Path) -> None:
    assert gain("envgs", toy(name), tmp_path) > 0.3


@pytest.mark.parametrize(
    "kind", cases(k for k in PERTURBATIONS if not k.startswith(("masks", "background")) and k not in AS_GIVEN)
)
def test_the_worst_of_each_kind_of_data_leaves_something_to_learn(
    toy: Callable[[str], Scene], kind: str, tmp_path: Path
) -> None:
    assert gain("envgs", repaired_scene(worst(toy("chrome_room"), kind)), tmp_path) > LEFT.get(kind, 0.2)


@pytest.mark.slow
@pytest.mark.parametrize("growth", ["guided", "gradient"])
@pytest.mark.parametrize("kind", AS_GIVEN)
def test_points_that_are_taken_as_they_are_given_break_a_training_which_says_so(
    toy: Callable[[str], Scene], kind: str, growth: str, tmp_path: Path
) -> None:
    scene = worst(toy("chrome_room"), kind)
    assert gain("envgs", scene, tmp_path, ["learns_nothing"], rules={"growth": growth}) < AS_GIVEN[kind][growth]
