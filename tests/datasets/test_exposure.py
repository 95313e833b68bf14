"""Equal exposure: against exposures that the tests themselves have put in."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from captures import HEIGHT, WIDTH, gradient, write_capture
from PIL import Image

from envgs_bench.core import Scene
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.formats.colmap_model import Model, Observations
from envgs_bench.datasets.photographs.exposure import brightened, view_offsets, with_equal_exposure

NAMES = [f"{index:03d}.png" for index in range(10)]
EXPOSURES = np.exp(np.random.default_rng(3).normal(0, 0.15, (10, 3)))
SEEN_AT = np.random.default_rng(4).uniform([12, 8], [WIDTH - 12, HEIGHT - 8], (30, 2))

needs_captures = pytest.mark.skipif(
    "ENVGS_BENCH_DATA" not in os.environ, reason="ENVGS_BENCH_DATA names no folder of real captures"
)


def load(root: Path, **settings: Any) -> Scene:
    return load_scene({"kind": "colmap", "root": str(root), **settings}, root.parent / "cache")


def images_of(scene: Scene) -> list[np.ndarray]:
    return [view.image.numpy() for view in sorted([*scene.train, *scene.test], key=lambda view: view.name)]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """The gradient picture ten times, each channel of each with an exposure of its own."""
    root = write_capture(tmp_path / "bench", NAMES, seen_at=SEEN_AT)
    for name, exposure in zip(NAMES, EXPOSURES, strict=True):
        Image.fromarray(exposed(exposure)).save(root / "images" / name)
    return root


def exposed(exposure: np.ndarray) -> np.ndarray:
    return np.clip(np.round(0.6 * gradient() * exposure), 0, 255).astype(np.uint8)


def test_pictures_come_out_equally_bright(root: Path) -> None:
    mean = np.exp(np.log(EXPOSURES).mean(axis=0))
    expected = 0.6 * gradient() * mean
    for image in images_of(load(root, equalize_exposure=True)):
        np.testing.assert_allclose(image, expected, atol=3)
    for image, exposure in zip(images_of(load(root)), EXPOSURES, strict=True):
        np.testing.assert_array_equal(image, exposed(exposure))  # not unless asked for


def test_reduced_copies_are_read_where_their_model_saw_points(root: Path) -> None:
    """A gradient's colors at wrong places would give wrong exposures: here each image is read at another scale."""
    (root / "small").mkdir()
    for name in NAMES:
        Image.open(root / "images" / name).resize((WIDTH // 2, HEIGHT // 2), Image.Resampling.BOX).save(
            root / "small" / name
        )
    large = images_of(load(root, equalize_exposure=True, downsample=2))
    small = images_of(load(root, equalize_exposure=True, images="small"))
    for one, other in zip(small, large, strict=True):
        np.testing.assert_allclose(one, other, atol=4)


def test_highlights_do_not_count_as_exposure() -> None:
    """A fifth of the observations is brighter by half and more, most of them in half of the views."""
    rng = np.random.default_rng(0)
    exposures, brightness = rng.normal(0, 0.1, 40), rng.normal(0, 0.5, 3000)
    views, points = rng.integers(0, 40, 20_000), rng.integers(0, 3000, 20_000)
    noise = rng.normal(0, 0.03, 20_000)
    values = exposures[views] + brightness[points] + noise
    bright = rng.uniform(size=20_000) < np.where(views < 20, 0.35, 0.05)
    values[bright] += rng.uniform(0.4, 1.0, int(bright.sum()))
    expected = exposures - exposures.mean()
    found = view_offsets(views, points, values, 40)
    assert np.abs(found - expected).max() < 0.02
    shifts = [values[views == view].mean() for view in range(40)]
    assert np.abs(shifts - np.mean(shifts) - expected).max() > 0.08  # which means alone would not see through


def test_offsets_of_views_that_share_nothing_have_mean_zero_each() -> None:
    values = np.array([0.0, 0.2, 1.0, 1.6])
    offsets = view_offsets(np.array([0, 1, 2, 3]), np.array([0, 0, 1, 1]), values, 5)
    np.testing.assert_allclose(offsets, [-0.1, 0.1, -0.3, 0.3, 0], atol=1e-6)


def test_images_with_too_few_points_stay_as_they_are(root: Path, caplog: pytest.LogCaptureFixture) -> None:
    model = Model(root / "sparse/0")
    photographs, _ = model.photographs(root / "images")
    observations = model.observations()
    few = observations["004.png"]
    observations["004.png"] = Observations(few.positions[:5], few.points[:5])
    equal = {p.name: p.gains for p in with_equal_exposure(photographs, observations, (0, 0, 0))}
    assert equal["004.png"] == (1, 1, 1)
    assert "stay as they are: 004.png" in caplog.text
    ratio = np.array(equal["001.png"]) / np.array(equal["002.png"])
    np.testing.assert_allclose(ratio, EXPOSURES[2] / EXPOSURES[1], rtol=0.03)


def test_a_model_without_tracks_cannot_tell(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"needs a model that says which image shows which points.*TRACK"):
        load(write_capture(tmp_path / "bench", NAMES), equalize_exposure=True)


def test_the_log_says_how_far_exposures_went(root: Path, caplog: pytest.LogCaptureFixture) -> None:
    load(root, equalize_exposure=True)
    brightness = np.exp(np.log(EXPOSURES).mean(axis=1))
    brightness /= np.exp(np.log(brightness).mean())
    said = re.search(r"exposures from ([\d.]+) to ([\d.]+) of their mean were made equal", caplog.text)
    assert said is not None
    np.testing.assert_allclose([float(text) for text in said.groups()], [brightness.min(), brightness.max()], atol=0.02)


def test_brightened_bytes_are_cut_at_white() -> None:
    picture = np.array([[[0, 100, 200]]], dtype=np.uint8)
    np.testing.assert_array_equal(brightened(picture, (2.0, 1.5, 1.5)), [[[0, 150, 255]]])


@needs_captures
def test_what_a_real_capture_is_darkened_by_is_found_again(tmp_path: Path) -> None:
    """Every third photograph of a real capture made darker: its exposure falls by that factor, the others' by none."""
    root = tmp_path / "door"
    shutil.copytree(Path(os.environ["ENVGS_BENCH_DATA"]) / "lund_door", root)
    before = gains_of(root)
    files = sorted((root / "images").iterdir())
    factor = np.where(np.arange(len(files)) % 3 == 0, 0.75, 1.0)
    for file, by in zip(files, factor, strict=True):
        os.chmod(file, 0o644)
        Image.fromarray(np.round(np.asarray(Image.open(file)) * by).astype(np.uint8)).save(file, quality=100)
    change = before / gains_of(root)
    expected = factor / np.exp(np.log(factor).mean())
    np.testing.assert_allclose(change, np.repeat(expected[:, None], 3, axis=1), rtol=0.02)


def gains_of(root: Path) -> np.ndarray:
    model = Model(root / "sparse/0")
    photographs, _ = model.photographs(root / "images")
    equal = with_equal_exposure(photographs, model.observations(), (0, 0, 0))
    return np.array([photograph.gains for photograph in equal])
