"""Validation views are taken out of the training views, test views stay, and facts are carried beside the pictures."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from captures import NAMES_OF_TEN, gradient, write_capture
from PIL import Image
from toy_scenes import rough_toys

from envgs_bench.core import Camera, Scene, View
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.export import export_scene
from envgs_bench.testing import tiny_scene

TOY = {
    "kind": "toy",
    "scene": "sky_ball",
    "width": 24,
    "height": 18,
    "views": 24,
    "normal_noise": 5,
    "supersampling": 1,
}


@pytest.fixture(scope="module", autouse=True)
def _rough() -> Iterator[None]:
    with rough_toys():
        yield


@pytest.fixture(scope="module")
def toys(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Scene, Scene]:
    """Without and with validation, and with it from another cache."""
    first, second = tmp_path_factory.mktemp("first"), tmp_path_factory.mktemp("second")
    scenes = (load_scene(TOY, first), *(load_scene({**TOY, "validation": True}, cache) for cache in (first, second)))
    assert len(list((first / "scenes").iterdir())) == 1  # both are one cached scene
    return scenes


def same(a: View, b: View) -> bool:
    return a.name == b.name and all(
        torch.equal(x, y) if x is not None and y is not None else x is y
        for x, y in ((a.image, b.image), (a.normal, b.normal), (a.depth, b.depth), *zip_masks(a, b))
    )


def zip_masks(a: View, b: View) -> list[tuple[torch.Tensor, torch.Tensor]]:
    assert a.masks.keys() == b.masks.keys()
    return [(a.masks[region], b.masks[region]) for region in a.masks]


def test_every_eighth_training_view_validates_from_the_first(toys: tuple[Scene, Scene, Scene]) -> None:
    whole, parted, _ = toys
    names = [view.name for view in whole.train]
    assert [view.name for view in parted.val] == [names[0], names[8], names[16]]
    assert [view.name for view in parted.train] == [n for i, n in enumerate(names) if i not in (0, 8, 16)]
    assert not whole.val


def test_the_other_views_and_the_points_stay_what_they_are(toys: tuple[Scene, Scene, Scene]) -> None:
    whole, parted, _ = toys
    before = {view.name: view for view in whole.train}
    assert all(same(view, before[view.name]) for view in parted.train)
    assert all(same(a, b) for a, b in zip(whole.test, parted.test, strict=True))
    assert torch.equal(whole.points, parted.points)


def test_the_split_is_the_same_each_time(toys: tuple[Scene, Scene, Scene]) -> None:
    _, once, again = toys
    for part in ("train", "val", "test"):
        assert all(same(a, b) for a, b in zip(getattr(once, part), getattr(again, part), strict=True))


def test_a_toy_s_validation_views_have_regions_and_exact_normals(
    toys: tuple[Scene, Scene, Scene], tmp_path: Path
) -> None:
    whole, parted, _ = toys
    exact = {view.name: view for view in load_scene({**TOY, "normal_noise": 0}, tmp_path).train}
    noisy = {view.name: view for view in whole.train}
    for view in parted.val:
        of_training = {region: mask for region, mask in view.masks.items() if region != "covisible"}
        assert same(replace(view, masks=of_training), exact[view.name])
        assert not torch.equal(view.normal, noisy[view.name].normal)
        assert view.masks.keys() == whole.test[0].masks.keys()


def guess(image: np.ndarray, camera: Camera) -> np.ndarray:
    return np.broadcast_to(np.float32([0, 0, -1]), image.shape)


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    root = write_capture(tmp_path / "bench", NAMES_OF_TEN)
    (root / "masks").mkdir()
    for name in NAMES_OF_TEN:
        Image.fromarray(255 * (gradient()[..., 0] > 100).astype(np.uint8)).save(root / "masks" / name)
    return root


def with_normals(root: Path) -> Path:
    (root / "normals").mkdir()
    for name in NAMES_OF_TEN:
        Image.fromarray(np.broadcast_to(np.uint8([128, 128, 0]), gradient().shape).copy()).save(root / "normals" / name)
    return root


def load(root: Path, **settings: Any) -> Scene:
    return load_scene({"kind": "colmap", "root": str(root), "validation": True, **settings}, root.parent / "cache")


def test_a_capture_s_validation_views_keep_masks_and_lose_guessed_normals(capture: Path) -> None:
    scene = load(capture, normal_estimator=f"{__name__}:guess")
    assert [view.name for view in scene.val] == ["001"]  # 000 and 008 test
    assert scene.val[0].masks["foreground"].any()
    assert scene.val[0].normal is None
    assert all(view.normal is not None for view in scene.train)


@pytest.mark.parametrize("exact", [False, True])
def test_normals_beside_images_are_scored_where_they_are_exact(capture: Path, exact: bool) -> None:
    scene = load(with_normals(capture), exact_normals=exact)
    assert all((view.normal is not None) == exact for view in [*scene.val, *scene.test])
    assert all(view.normal is not None for view in scene.train)


@pytest.mark.parametrize("learned", [False, True])
def test_a_rendered_scene_s_validation_views_have_the_normals_beside_them(tmp_path: Path, learned: bool) -> None:
    toy = load_scene(TOY, tmp_path / "cache")
    given = export_scene(toy, tmp_path / "blender", "blender")
    whole = load_scene({**given, "train_normals": learned}, tmp_path / "cache")
    parted = load_scene({**given, "train_normals": learned, "validation": True}, tmp_path / "cache")
    expected = [f"train_{toy.train[index].name}" for index in (0, 8, 16)]
    assert [view.name for view in parted.val] == expected
    assert all(torch.equal(view.normal, toy.train[i].normal) for view, i in zip(parted.val, (0, 8, 16), strict=True))
    assert all((view.normal is not None) == learned for view in [*whole.train, *parted.train])


def own_source(settings: Mapping[str, Any], cache_dir: Path) -> Scene:
    assert set(settings) == {"kind", "count"}  # what holds for every source is not the source's business
    view = tiny_scene().train[0]
    normal = torch.zeros(view.image.shape)
    views = [replace(view, name=f"{index}", normal=normal) for index in range(settings["count"])]
    return replace(tiny_scene(), train=views)


def test_a_source_of_ones_own_is_split_alike(tmp_path: Path) -> None:
    given = {"kind": f"{__name__}:own_source", "validation": True, "free_space": 0.5, "bounds": 4}
    scene = load_scene({**given, "count": 12}, tmp_path)
    assert [view.name for view in scene.val] == ["0", "8"]
    assert all(view.normal is None for view in scene.val)  # nothing says that they are exact
    assert (scene.free_space, scene.bounds) == (0.5, 4)
    assert [view.name for view in load_scene({**given, "count": 2}, tmp_path).val] == ["0"]
    with pytest.raises(
        DatasetError, match=r"validation=true: tiny has 1 for training and validation, expected at least two"
    ):
        load_scene({**given, "count": 1}, tmp_path)


def test_facts_are_carried_and_change_no_cached_scene(capture: Path) -> None:
    plain, stated = load(capture), load(capture, free_space=2.2, bounds=30.0)
    assert (plain.free_space, plain.bounds) == (0, 0)
    assert (stated.free_space, stated.bounds) == (2.2, 30)
    assert len(os.listdir(capture.parent / "cache/scenes")) == 1


def test_facts_are_exported(capture: Path, tmp_path: Path) -> None:
    scene = load(capture, validation=False, free_space=2.2)
    again = load_scene(export_scene(scene, tmp_path / "out", "blender"), tmp_path / "cache")
    assert (again.free_space, again.bounds) == (2.2, 0)


@pytest.mark.parametrize("key", ["free_space", "bounds"])
@pytest.mark.parametrize("value", [-1, float("inf"), "wide"])
def test_facts_that_are_no_lengths_are_refused(capture: Path, key: str, value: Any) -> None:
    with pytest.raises(DatasetError, match=f"dataset.{key}="):
        load(capture, **{key: value})


def test_no_format_holds_a_validation_split(capture: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"export it with dataset\.validation=false"):
        export_scene(load(capture), tmp_path / "out", "blender")
