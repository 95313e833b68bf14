"""Views that are brighter or darker than the others, or of another tint, are found by the points and made equal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from toy_scenes import coarse_toys, worst

from envgs_bench.core import Scene
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.formats.srgb import to_linear, to_srgb
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.diagnosis.exposures import Exposures, equalized, exposures
from envgs_bench.diagnosis.observations import Observations
from envgs_bench.diagnosis.repair import repaired

NEAR = 0.2


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    toy = {"kind": "toy", "scene": "chrome_room", "width": 40, "height": 30, "views": 48, "supersampling": 1}
    with coarse_toys():
        return load_scene(toy | {"normal_noise": 0.0}, tmp_path_factory.mktemp("cache"))


def found_in(scene: Scene) -> Exposures:
    return exposures(Observations.of(scene, NEAR))


def brightened(scene: Scene, factors: np.ndarray) -> Scene:
    """The scene with the linear light of its training views times `factors` [V, 3]."""
    views = []
    for view, own in zip(scene.train, factors, strict=True):
        light = to_linear(view.image.numpy() / 255) * own
        views.append(replace(view, image=torch.from_numpy(np.round(255 * to_srgb(light.clip(0, 1)))).byte()))
    return replace(scene, train=views)


def off_by(scene: Scene, true: Scene) -> float:
    """Mean difference of the scene's training pictures to the true ones, in steps of 1/255."""
    pairs = zip(scene.train, true.train, strict=True)
    return float(np.mean([(own.image.float() - other.image.float()).abs().mean() for own, other in pairs]))


def errors(scene: Scene, found: Exposures, factors: np.ndarray) -> np.ndarray:
    """Logarithms by which the factors found for nearly all training views are off the true ones [V, 3]."""
    pairs = zip(scene.train, factors, strict=True)
    logs = [np.log(found.factors[view.name].numpy() / own) for view, own in pairs if view.name in found.factors]
    assert len(logs) > 0.9 * len(scene.train)
    return np.abs(logs)


@pytest.mark.parametrize("stops", [0.8, 1.5])
def test_factors_of_light_are_found(room: Scene, stops: float) -> None:
    drawn = 2 ** (stops * np.random.default_rng(0).normal(size=(len(room.train), 1)).repeat(3, axis=1))
    found = found_in(brightened(room, drawn))
    assert np.median(errors(room, found, drawn)) < 0.15  # a fifth of a stop
    assert np.median(np.log(drawn)) != pytest.approx(0, abs=0.03)  # so that how bright all should be was found as well
    assert found.stops == pytest.approx(stops * 0.67, rel=0.35)  # the median of a normal distribution's deviations


def test_tints_are_found_channel_by_channel(room: Scene) -> None:
    drawn = np.exp(0.45 * np.random.default_rng(1).normal(size=(len(room.train), 3)))
    assert np.median(errors(room, found_in(brightened(room, drawn)), drawn)) < 0.1


@pytest.mark.parametrize("kind", ["exposure", "white_balance"])
def test_what_is_learned_from_is_nearer_to_the_truth(room: Scene, kind: str) -> None:
    broken = worst(room, kind)
    found, (outcome,) = repaired(Diagnosis(broken), ["exposures"])
    assert outcome.kept
    assert "equally bright" in outcome.message
    learned = found.scene
    assert learned.points is broken.points
    assert off_by(learned, room) < 0.5 * off_by(broken, room)
    assert torch.equal(learned.test[0].image, room.test[0].image)


def test_views_that_are_equally_bright_stay_as_they_are(room: Scene) -> None:
    given = Diagnosis(room)
    found, (outcome,) = repaired(given, ["exposures"])
    assert found is given
    assert not outcome.kept
    assert 0 < found_in(room).deviation < 0.1


@pytest.mark.parametrize("kind", ["noise", "blur", "pose_rotation", "pose_translation", "points_noisy"])
def test_nothing_else_passes_for_an_exposure(room: Scene, kind: str) -> None:
    assert found_in(worst(room, kind)).factors == {}


def test_points_of_one_color_say_nothing(room: Scene) -> None:
    gray = replace(worst(room, "exposure"), point_colors=torch.full_like(room.point_colors, 0.5))
    assert found_in(gray) == Exposures()


def test_points_in_no_view_say_nothing(room: Scene) -> None:
    assert found_in(replace(room, points=room.points + 1e4)) == Exposures()


def test_points_that_the_views_contradict_say_nothing(room: Scene) -> None:
    """Of pictures that differ, but not by what they show at the points."""
    other = replace(worst(room, "exposure"), points=room.points.roll(1, dims=0))
    given = Diagnosis(other)
    assert repaired(given, ["exposures"])[0] is given


def test_a_picture_made_equal_is_as_it_would_have_been() -> None:
    dark = torch.arange(0, 120, dtype=torch.uint8).reshape(5, 8, 3)
    factors = np.array([2.0, 3.0, 1.5])
    bright = torch.from_numpy(np.round(255 * to_srgb(to_linear(dark.numpy() / 255) * factors))).byte()
    assert (equalized(bright, torch.from_numpy(factors).float()).int() - dark.int()).abs().max() <= 1
