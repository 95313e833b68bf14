"""Picking a data source, splitting its views, and keeping scenes on disk."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import pytest
import torch

from envgs_bench.core import Scene
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.notes import collecting
from envgs_bench.datasets.registry import MISSING, SETTINGS, default_settings, files_read
from envgs_bench.datasets.settings import SourceSettings, parse_dataset_settings
from envgs_bench.datasets.source import Source
from envgs_bench.datasets.split import split_views
from envgs_bench.datasets.store.cache import cached_scene
from envgs_bench.testing import tiny_scene


def own_source(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    return replace(tiny_scene(), name=f"{settings['name']} in {cache_dir.name}")


WHOLE = Source(own_source, files_read=lambda settings: [Path(settings["root"]) / "poses.txt"])


def test_a_whole_source_of_ones_own_tells_its_files(tmp_path: Path) -> None:
    (tmp_path / "poses.txt").touch()
    settings = {"kind": f"{__name__}:WHOLE", "name": "mine", "root": str(tmp_path)}
    assert load_scene(settings, tmp_path / "cache").name == "mine in cache"
    assert files_read(settings) == [tmp_path / "poses.txt"]
    assert files_read({**settings, "kind": f"{__name__}:own_source"}) is None  # a function alone does not


def test_a_source_of_ones_own(tmp_path: Path) -> None:
    scene = load_scene({"kind": f"{__name__}:own_source", "name": "mine"}, tmp_path / "here")
    assert scene.name == "mine in here"


def test_a_source_of_ones_own_with_a_real_point_cloud(tmp_path: Path) -> None:
    """Photographs are not all that a source can read: pictures here are drawn from the cloud, so it must be in them."""
    root = Path(os.environ.get("ENVGS_BENCH_DATA", "")) / "gsplat_garden"
    if "ENVGS_BENCH_DATA" not in os.environ or not root.is_dir():
        pytest.skip("ENVGS_BENCH_DATA names no folder with gsplat_garden")
    scene = load_scene({"kind": "fakes.datasets:garden", "root": str(root), "downsample": 4}, tmp_path)
    assert (len(scene.points), len(scene.train), len(scene.test)) == (138_766, 2, 1)
    assert all((view.image > 8).float().mean() > 0.5 for view in [*scene.train, *scene.test])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "dataset.kind=None: expected one of toy, colmap"),
        ({"kind": "polycam"}, "dataset.kind='polycam' is unknown: expected one of toy, colmap"),
        ({"kind": "nowhere:load"}, "dataset.kind='nowhere:load' cannot be imported .*No module named 'nowhere'"),
        ({"kind": "os:load"}, "dataset.kind='os:load' cannot be imported"),
        ({"kind": ":load"}, "dataset.kind=':load' cannot be imported"),
        ({"kind": ".mine:load"}, "dataset.kind='.mine:load' cannot be imported"),
    ],
)
def test_unknown_kinds_are_named(tmp_path: Path, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(DatasetError, match=message):
        load_scene(settings, tmp_path)


@pytest.mark.parametrize("count", [2, 8, 9, 17])
def test_every_eighth_view_tests(count: int) -> None:
    view = tiny_scene().train[0]
    views = [replace(view, name=f"{index:03d}") for index in range(count)]
    train, test = split_views(views, "here")
    assert [int(view.name) for view in test] == list(range(0, count, 8))
    assert [int(view.name) for view in train] == [index for index in range(count) if index % 8]


def test_too_few_views_and_equal_names() -> None:
    view = tiny_scene().train[0]
    with pytest.raises(DatasetError, match="here: 1 image, expected at least two"):
        split_views([view], "here")
    with pytest.raises(DatasetError, match="here: 0 images, expected at least two"):
        split_views([], "here")
    with pytest.raises(DatasetError, match=f"here: several images are called {view.name}"):
        split_views([view, view], "here")


def test_a_cached_scene_comes_back_whole(tmp_path: Path) -> None:
    made = []

    def make() -> Scene:
        made.append(1)
        return tiny_scene()

    first, second = (cached_scene(tmp_path, "a/b", {"x": 1}, make) for _ in range(2))
    assert len(made) == 1
    assert second.name == first.name
    assert torch.equal(second.background, first.background)
    for ours, theirs in zip([*first.train, *first.test], [*second.train, *second.test], strict=True):
        assert torch.equal(ours.camera.world_to_camera, theirs.camera.world_to_camera)
        for field in ("normal", "depth", "image"):
            a, b = getattr(ours, field), getattr(theirs, field)
            assert (a is None and b is None) or torch.equal(a, b)
    cached_scene(tmp_path, "a/b", {"x": 2}, make)
    assert len(made) == 2


def test_a_damaged_file_is_made_again(tmp_path: Path) -> None:
    cached_scene(tmp_path, "a", {}, tiny_scene)
    (path,) = (tmp_path / "scenes").iterdir()
    path.write_bytes(path.read_bytes()[:100])
    with pytest.warns(UserWarning, match="cannot be read .* it is made again"):
        scene = cached_scene(tmp_path, "a", {}, tiny_scene)
    assert torch.equal(scene.points, tiny_scene().points)
    assert cached_scene(tmp_path, "a", {}, lambda: pytest.fail("made a third time")).name == scene.name


def test_a_scene_is_given_even_where_nothing_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with collecting() as notes:
        assert cached_scene(tmp_path / "file", "a", {}, tiny_scene).name == tiny_scene().name
    (text,) = notes
    assert f"could not be cached in {tmp_path / 'file/scenes'}" in text


def test_a_crash_while_making_leaves_nothing(tmp_path: Path) -> None:
    def make() -> Scene:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cached_scene(tmp_path, "a", {}, make)
    assert not list(tmp_path.rglob("*.*"))


@pytest.mark.parametrize(("kind", "model"), SETTINGS.items())
def test_defaults_hold_every_setting_and_are_the_sources_own(kind: str, model: type[SourceSettings]) -> None:
    given = default_settings(kind)
    assert get_args(model.model_fields["kind"].annotation) == (kind,)
    assert set(given) == set(model.model_fields)
    required = {key: "chrome_room" for key, value in given.items() if value == MISSING}
    assert parse_dataset_settings(model, given | required) == model(kind=kind, **required)
