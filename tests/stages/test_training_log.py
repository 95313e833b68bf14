"""What a logger is told while a run trains, and that the training does not notice."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio

from envgs_bench.core import Scene
from envgs_bench.methods.registry import create_method
from envgs_bench.stages.training import Training
from envgs_bench.stages.training_log import TrainingLog, spread
from envgs_bench.testing import HEIGHT, WIDTH, tiny_scene

STEPS = 13


class Remembering:
    """A logger that keeps what it is told."""

    def __init__(self) -> None:
        self.told: dict[str, dict[int, float]] = {}
        self.pictures: dict[tuple[str, int], np.ndarray] = {}

    def numbers(self, step: int, values: Mapping[str, float]) -> None:
        torch.rand(7)  # a library may draw from the global generator
        for name, value in values.items():
            self.told.setdefault(name, {})[step] = value

    def picture(self, step: int, name: str, picture: np.ndarray) -> None:
        self.pictures[name, step] = picture

    def close(self) -> None:
        pass


def trained(kind: str, folder: Path, scene: Scene, logger: Remembering | None) -> tuple[Training, list[dict[str, str]]]:
    torch.manual_seed(0)
    method = create_method(kind, {}, "cpu", seed=1)
    log = TrainingLog(logger, method, scene, every=5, views=2) if logger else None
    training = Training(method, scene, STEPS, 0, log)
    folder.mkdir()
    training.run(folder / "curve.csv", lambda event: None)
    rows = list(csv.DictReader((folder / "curve.csv").open()))
    return training, [{name: value for name, value in row.items() if name != "seconds"} for row in rows]


@pytest.mark.parametrize("kind", ["3dgs", "envgs", "envmap"])
def test_a_training_that_is_logged_ends_as_one_that_is_not(tmp_path: Path, kind: str) -> None:
    scene, logger = tiny_scene(), Remembering()
    plain, rows = trained(kind, tmp_path / "plain", scene, None)
    logged, rows_too = trained(kind, tmp_path / "logged", scene, logger)
    assert rows_too == rows
    camera = scene.test[0].camera
    assert torch.equal(plain.method.render(camera).color, logged.method.render(camera).color)
    for name, trained_set in plain.method.model.sets.items():
        for key, values in trained_set.parameters.tensors.items():
            assert torch.equal(values, logged.method.model.sets[name].parameters.tensors[key]), (name, key)
    assert logger.pictures


def test_curves_are_the_runs_own_and_pictures_those_of_the_model_as_it_stands(tmp_path: Path) -> None:
    scene, logger = tiny_scene(), Remembering()
    training, rows = trained("envgs", tmp_path / "run", scene, logger)
    assert list(logger.told["training/loss"]) == [int(row["step"]) for row in rows] == list(range(1, STEPS + 1))
    for row in rows:
        step = int(row["step"])
        assert logger.told["training/loss"][step] == float(row["loss"])
        assert logger.told["training/psnr"][step] == float(row["psnr"])
        assert logger.told["training/primitives_base"][step] == float(row["primitives_base"])
        terms = [told[step] for name, told in logger.told.items() if step in told and name in TERMS]
        assert sum(terms) == pytest.approx(float(row["loss"]), rel=1e-5)
    view = scene.test[0]
    assert list(logger.pictures) == [(f"test/{view.name}", step) for step in (5, 10, STEPS)]
    photograph, image, error = np.split(logger.pictures[f"test/{view.name}", STEPS], 3, axis=1)
    assert photograph.shape == (HEIGHT, WIDTH, 3)
    assert np.array_equal(photograph, view.image.numpy())
    drawn = training.method.render(view.camera).color.clamp(0, 1)
    assert np.abs(image - 255 * drawn.numpy()).max() <= 0.5 + 1e-3
    expected = 4 * np.abs(drawn.numpy() - view.rgb().numpy()).mean(axis=2, keepdims=True)
    assert np.abs(error / 255 - expected.clip(0, 1)).max() < 0.003
    psnr = peak_signal_noise_ratio(view.rgb().numpy(), drawn.numpy(), data_range=1)
    assert logger.told["test/psnr"][STEPS] == pytest.approx(psnr, abs=1e-3)
    assert math.isfinite(training.seconds)


TERMS = {f"training/{term}" for term in ("rgb", "normal", "mono", "perceptual", "opacity", "scale")}


def test_validation_views_are_looked_at_where_there_are_some(tmp_path: Path) -> None:
    scene, logger = tiny_scene(), Remembering()
    trained("2dgs", tmp_path / "run", replace(scene, train=scene.train[2:], val=scene.train[:2]), logger)
    assert {name for name, _ in logger.pictures} == {f"validation/{view.name}" for view in scene.train[:2]}
    assert sorted(logger.told["validation/psnr"]) == [5, 10, STEPS]


def test_views_are_spread_evenly() -> None:
    views = tiny_scene().train
    assert spread(views, 2) == [views[0], views[2]]
    assert spread(views, 99) == views
