"""Noise, lost detail and JPEG's blocks are told from photographs alone, and nothing of photographs in order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from toy_scenes import coarse_toys

from envgs_bench.core import Scene
from envgs_bench.datasets import load_scene
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.diagnosis.photographs import Photographs, blockiness, detail, noise
from envgs_bench.diagnosis.scene_warnings import scene_warnings
from envgs_bench.diagnosis.thresholds import BLOCKY, BLURRED, NOISY

KINDS = {"noise": "views_noisy", "blur": "views_blurred", "jpeg": "views_blocky"}


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    toy = {"kind": "toy", "scene": "chrome_room", "width": 96, "height": 72, "views": 17, "supersampling": 3}
    with coarse_toys():
        return load_scene(toy, tmp_path_factory.mktemp("cache"))


def perturbed(scene: Scene, kind: str, severity: int) -> Scene:
    return PERTURBATIONS[kind].applied(scene, severity, kind, seed=0)


def said(scene: Scene) -> set[str]:
    return {warning.kind for warning in scene_warnings(Diagnosis(scene), 300)} & set(KINDS.values())


@pytest.mark.parametrize("kind", KINDS)
def test_the_worst_that_a_training_learns_without_a_word_is_said(room: Scene, kind: str) -> None:
    assert KINDS[kind] in said(perturbed(room, kind, 3))
    assert not said(perturbed(room, kind, 1)) - {"views_blocky"}


def test_of_photographs_in_order_nothing_is_said_however_bright_or_tinted(room: Scene) -> None:
    assert said(room) == set()
    assert said(perturbed(room, "exposure", 3)) == set()
    assert said(perturbed(room, "white_balance", 3)) == set()


def test_noise_is_the_deviation_of_what_was_added() -> None:
    rng = np.random.default_rng(0)
    ramp = np.linspace(0.3, 0.7, 200)[None, :].repeat(150, axis=0)
    for deviation in (0.02, 0.05, 0.1):
        noisy = torch.from_numpy(ramp + deviation * rng.standard_normal(ramp.shape)).float()
        assert noise(noisy) == pytest.approx(deviation, rel=0.3)  # of the flattest windows: a little less
    assert noise(torch.from_numpy(ramp).float()) < 1e-6


def test_noise_is_not_told_where_it_was_cut_off_or_in_too_few_pixels() -> None:
    assert noise(torch.ones(100, 100)) == 0.0
    assert noise(torch.rand(20, 20)) == 0.0
    assert noise(torch.rand(4, 4)) == 0.0


def test_detail_is_what_a_blur_takes_at_any_number_of_pixels(room: Scene) -> None:
    for scale in (1, 4):
        wide = [view.image.repeat_interleave(scale, 0).repeat_interleave(scale, 1) for view in room.train]
        scene = replace(room, train=[replace(v, image=w) for v, w in zip(room.train, wide, strict=True)])
        sharp, blurred = Photographs.of(scene.train), Photographs.of(perturbed(scene, "blur", 3).train)
        assert sharp.detail > 2 * BLURRED
        assert blurred.detail < BLURRED


def test_nothing_to_be_seen_has_lost_no_detail() -> None:
    assert detail(torch.zeros(64, 64)) == 1.0
    assert detail(torch.full((48, 64), 0.5)) == 1.0
    assert detail(torch.zeros(4, 4)) == 1.0


def test_blocks_are_found_where_jpeg_cuts_and_not_between(room: Scene) -> None:
    green = perturbed(room, "jpeg", 3).train[0].image[..., 1].float() / 255
    assert blockiness(green) > 3 * BLOCKY
    assert blockiness(green[4:, 4:]) < 0.25 * BLOCKY
    assert blockiness(torch.zeros(64, 64)) == 0.0
    assert blockiness(torch.rand(12, 12)) == 0.0


def test_median_views_count(room: Scene) -> None:
    worst = perturbed(room, "noise", 3)
    some = replace(room, train=[*worst.train[:4], *room.train[4:]])
    assert Photographs.of(some.train).noise < NOISY < Photographs.of(worst.train).noise
