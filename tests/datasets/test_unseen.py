"""Cameras between and beyond those that train: where they are, what they look at, and that truth is known there."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from fakes.runs import only_folder, records, run_job_here, set_environment
from toy_scenes import rough_toys

from envgs_bench.core import Camera
from envgs_bench.datasets.registry import load_scene
from envgs_bench.datasets.toy.cameras import cameras_around
from envgs_bench.datasets.toy.scenes import Orbit
from envgs_bench.datasets.unseen import between, beyond
from envgs_bench.metrics import get_protocol
from envgs_bench.reports import build_report
from envgs_bench.stored.rescoring import rescore

ORBIT = Orbit(
    radius=2.0,
    radius_swing=0.0,
    height=1.0,
    height_swing=0.0,
    target=(0.0, 0.0, 0.5),
    field_of_view_degrees=60.0,
)
TOY = {"kind": "toy", "scene": "sky_ball", "width": 32, "height": 24, "views": 9, "supersampling": 1}


@pytest.fixture(scope="module", autouse=True)
def _rough() -> Iterator[None]:
    with rough_toys():
        yield


def cameras() -> list[Camera]:
    return cameras_around(ORBIT, 16, 32, 24)


def centers(found: list[Camera]) -> np.ndarray:
    return np.stack([camera.center.double().numpy() for camera in found])


def axes_of(found: list[Camera]) -> np.ndarray:
    """The directions that they look in."""
    return np.stack([camera.world_to_camera[2, :3].double().numpy() for camera in found])


def test_half_way_is_where_the_orbit_has_it() -> None:
    """Of a circle: the chord's middle, and the direction of the angle between."""
    taken = cameras()
    found = between(taken, 15)
    angles = 2 * np.pi * (np.arange(15) + 0.5) / 16
    chord = 2 * np.cos(np.pi / 16)
    expected = np.stack([chord * np.cos(angles), chord * np.sin(angles), np.full(15, 1.0)], 1)
    np.testing.assert_allclose(centers(found), expected, atol=1e-6)
    ahead = axes_of(found)
    np.testing.assert_allclose(np.arctan2(-ahead[:, 1], -ahead[:, 0]) % (2 * np.pi), angles, atol=1e-6)


def test_beyond_is_nearer_and_further_and_looks_at_the_same() -> None:
    """In a world of nothing but the target, at a free length of the distance to it."""
    taken = cameras()
    target = np.array(ORBIT.target)
    distance = float(np.linalg.norm(centers(taken)[0] - target))

    def free(place: np.ndarray, direction: np.ndarray) -> float:
        to_target = target - place
        return float(np.linalg.norm(to_target)) if direction @ to_target > 0.99 * distance else np.inf

    found = beyond(taken, 4, 2.0, free)
    lengths = np.linalg.norm(centers(found) - target, axis=1)
    np.testing.assert_allclose(lengths[::2], distance / 2, atol=1e-5)
    assert (lengths[1::2] > distance + 0.5).all()
    toward = (target - centers(found)) / lengths[:, None]
    np.testing.assert_allclose((axes_of(found) * toward).sum(1), 1, atol=1e-6)
    for camera in found:
        assert torch.allclose(torch.linalg.det(camera.world_to_camera[:3, :3]), torch.tensor(1.0), atol=1e-5)
        assert abs(float(camera.world_to_camera[0, 2])) < 1e-6  # upright


def test_walls_are_kept_clear_of() -> None:
    found = beyond(cameras(), 4, 2.0, lambda place, direction: 0.2)
    moves = np.linalg.norm(centers(found)[:, None] - centers(cameras())[None], axis=2).min(1)
    np.testing.assert_allclose(moves, 0.1, atol=1e-6)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def test_a_toy_has_them_and_stays_what_it_is(cache: Path) -> None:
    plain, more = (load_scene({**TOY, "unseen": count}, cache) for count in (0, 3))
    assert not plain.unseen
    assert {place: len(views) for place, views in more.unseen.items()} == {"between": 3, "beyond": 3}
    for one, other in zip((*plain.train, *plain.test), (*more.train, *more.test), strict=True):
        assert torch.equal(one.image, other.image)
    assert torch.equal(plain.points, more.points)
    again = load_scene({**TOY, "unseen": 3}, cache)
    for place, views in more.unseen.items():
        for view, kept in zip(views, again.unseen[place], strict=True):
            assert view.name.startswith(place)
            assert torch.equal(view.image, kept.image)
            assert view.normal is not None
            assert "covisible" in view.masks


def test_a_step_forward_halves_the_depth_in_the_middle(cache: Path) -> None:
    """So that truth is that of the place."""
    scene = load_scene({**TOY, "unseen": 3}, cache)
    nearer, taken = scene.unseen["beyond"][0], scene.train[int(0.5 * len(scene.train) / 3)]
    middles = []
    for view in (nearer, taken):
        assert view.depth is not None
        middles.append(float(view.depth[11:13, 15:17].mean()))
    assert middles[0] == pytest.approx(middles[1] / 2, rel=0.1)


def test_a_run_scores_them_beside_its_test_views(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)
    toy = [f"dataset.{name}={value}" for name, value in TOY.items() if name not in ("kind", "scene")]
    given = ("dataset=toy/sky_ball", *toy, "dataset.unseen=3", f"cache_dir={cache}", "method=2dgs", "steps=3")
    assert run_job_here(tmp_path / "runs", *given) == 0
    (record,) = records(tmp_path / "runs")
    assert set(record.unseen) == {"between", "beyond"}
    for place, metrics in record.unseen.items():
        assert [view.view for view in metrics.per_view] == [f"{place}-{index:04d}" for index in range(3)]
        assert metrics.mean["psnr"] is not None
        assert metrics.mean["normal_degrees"] is not None
    build_report(tmp_path / "runs", tmp_path / "report")
    table = (tmp_path / "report" / "table.md").read_text()
    assert "PSNR between" in table
    assert "PSNR beyond" in table
    rescored = rescore(only_folder(tmp_path / "runs"), get_protocol("strict"), tmp_path / "again")
    before, after = record.unseen["beyond"].mean["psnr"], rescored.unseen["beyond"].mean["psnr"]
    assert before is not None
    assert after == pytest.approx(before, abs=0.1)
