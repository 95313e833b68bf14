"""The shipped toy scenes: what their views, regions and points promise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from toy_scenes import rough_toys

from envgs_bench.core import Scene, View
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.settings import TALLEST
from envgs_bench.datasets.toy import making
from envgs_bench.datasets.toy.normal_noise import noisy_normals
from envgs_bench.datasets.toy.points import sfm_points
from envgs_bench.datasets.toy.scenes import SCENES
from envgs_bench.metrics import MINIMUM_SIZE
from envgs_bench.stages.loading import check_scene

SMALL = {"kind": "toy", "width": 64, "height": 48, "views": 17, "noise": 0.0, "supersampling": 1}
MORE_REGIONS = {
    "glass": {"transmissive"},
    "copper_table": {"mirror", "coated", "diffuse"},
    "brushed_patio": {"mirror", "coated", "diffuse"},
}
Load = Callable[..., Scene]


@pytest.fixture(scope="module")
def load(tmp_path_factory: pytest.TempPathFactory) -> Load:
    """Loads a small toy scene through one cache, so that each is made once."""
    cache = tmp_path_factory.mktemp("cache")

    def load_small(scene: str, **settings: Any) -> Scene:
        return load_scene({**SMALL, "scene": scene, **settings}, cache)

    with rough_toys():
        yield load_small


def views_of(scene: Scene) -> list[View]:
    return sorted([*scene.train, *scene.test], key=lambda view: view.name)


def seen_from(view: View, other: View) -> tuple[np.ndarray, np.ndarray]:
    """For each pixel of `view`: is its surface seen by `other`, and the colors [N, 3] × 2 of those that are."""
    origins, directions = view.camera.rays()
    pixels, depth = other.camera.project(origins + view.depth[..., None] * directions)
    column, row = pixels.floor().long().clamp(min=0).unbind(-1)
    inside = (view.depth > 0) & (depth > 0) & (pixels >= 0).all(-1)
    inside &= (column < other.camera.width) & (row < other.camera.height)
    column, row = column.clamp(max=other.camera.width - 1), row.clamp(max=other.camera.height - 1)
    seen = inside & ((other.depth[row, column] - depth).abs() < 0.02 * depth)
    return seen, torch.stack([view.rgb(), other.rgb()[row, column]])


def neighborhood_range(view: View) -> torch.Tensor:
    """Largest minus smallest value among each pixel and its eight neighbors, [H, W], over all channels."""
    picture = view.rgb().permute(2, 0, 1)[None]
    return sum(torch.nn.functional.max_pool2d(sign * picture, 3, 1, 1) for sign in (1, -1)).amax((0, 1))


@pytest.mark.parametrize("name", SCENES)
def test_views_are_complete_and_every_eighth_tests(load: Load, name: str) -> None:
    scene = load(name)
    assert scene.name == f"toy/{name}"
    tested = [view.name for view in scene.test]
    assert tested == ["0000", "0008", "0016"]
    assert [view.name for view in views_of(scene)] == [f"{index:04d}" for index in range(17)]
    for view in views_of(scene):
        assert view.image.shape == (48, 64, 3)
        assert view.image.dtype == torch.uint8
        assert view.image.float().std() > 30
        hit = view.depth > 0
        length = view.normal.norm(dim=-1)
        assert torch.allclose(length, hit.float(), atol=1e-5)
        assert ((view.normal * view.camera.rays()[1]).sum(-1)[hit] < 0).all()
        assert view.depth[hit].min() > 0.4  # clear of the rasterizer's near plane
        scored = {"covisible"} if view.name in tested else set()
        assert set(view.masks) == {"reflective", "near_field"} | MORE_REGIONS.get(name, set()) | scored
        assert not (view.masks["near_field"] & ~view.masks["reflective"]).any()
        assert not (view.masks["reflective"] & ~hit).any()


def test_regions_say_what_a_scene_is_for(load: Load) -> None:
    def share(name: str, region: str) -> float:
        return float(torch.stack([view.masks[region] for view in views_of(load(name))]).float().mean())

    assert share("chrome_room", "reflective") > 0.2
    assert share("chrome_room", "near_field") > 0.9 * share("chrome_room", "reflective")
    assert share("sky_ball", "reflective") > 0.2
    assert share("sky_ball", "near_field") == 0  # where the ball's edge shows the ground, a pixel a view, is no region
    assert share("diffuse_room", "reflective") == 0
    assert 0.4 < share("lacquered_table", "near_field") / share("lacquered_table", "reflective") < 0.75
    for name in ("facing_mirrors", "wavy_mirror", "thin_rails"):
        assert share(name, "reflective") > 0.2
        assert share(name, "near_field") > 0.9 * share(name, "reflective")
    assert share("glass", "transmissive") == share("glass", "reflective") > 0.3


def test_facing_mirrors_show_each_other(load: Load, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What a single traced bounce would leave out is seen: the mirrors' pictures change when paths end after one."""
    settings = {**SMALL, "scene": "facing_mirrors", "views": 4}
    deep = load_scene(settings, tmp_path / "deep")
    describe = SCENES["facing_mirrors"]
    monkeypatch.setitem(SCENES, "facing_mirrors", lambda rng: replace(describe(rng), bounces=1))
    single = load_scene(settings, tmp_path / "single")
    view, other = deep.train[0], single.train[0]
    mirror = view.masks["reflective"]
    difference = (view.rgb() - other.rgb()).abs().amax(-1)
    changed, elsewhere = ((difference[where] > 0.1).float().mean() for where in (mirror, ~mirror))
    assert changed > 0.1
    assert elsewhere < 0.3 * changed  # pixels that a mirror covers in part


def test_normals_are_those_of_the_depth_map(load: Load) -> None:
    view = load("diffuse_room").train[3]
    origins, directions = view.camera.rays()
    points = origins + view.depth[..., None] * directions
    across, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    crossed = torch.nn.functional.normalize(torch.linalg.cross(down, across), dim=-1)
    cosine = (crossed * view.normal[1:-1, 1:-1]).sum(-1)[view.depth[1:-1, 1:-1] > 0]
    assert cosine.median() > 0.9999
    assert (cosine > 0.99).float().mean() > 0.7  # the rest lies along edges


def test_wavy_normals_are_those_of_the_surface(load: Load) -> None:
    """Along a flat mirror they would be one: here they spread, smoothly, and agree with the depth map's."""
    view = load("wavy_mirror").train[3]
    origins, directions = view.camera.rays()
    points = origins + view.depth[..., None] * directions
    across, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    crossed = torch.nn.functional.normalize(torch.linalg.cross(down, across), dim=-1)
    mirror = view.masks["reflective"]
    inner = mirror[1:-1, 1:-1] & mirror[1:-1, 2:] & mirror[1:-1, :-2] & mirror[2:, 1:-1] & mirror[:-2, 1:-1]
    normals = view.normal[1:-1, 1:-1]
    degrees = torch.rad2deg(torch.acos((crossed * normals).sum(-1).clamp(-1, 1)))[inner]
    assert inner.sum() > 300
    assert degrees.median() < 1.5
    assert torch.rad2deg(normals[inner].std(0).norm()) > 3


def test_diffuse_surfaces_look_the_same_from_everywhere_and_mirrors_do_not(load: Load) -> None:
    """Depth carries pixels of one view into the next: diffuse ones keep their color, reflections move."""
    diffuse, mirror = [], []
    scene = load("chrome_room")
    ordered = views_of(scene)
    for view, other in pairwise(ordered):
        seen, (ours, theirs) = seen_from(view, other)
        # level patches only: elsewhere the two pixels cover different areas of a pattern
        level = neighborhood_range(view) < 0.15
        difference = (ours - theirs).abs().mean(-1)
        diffuse.append(difference[seen & level & ~view.masks["reflective"]])
        mirror.append(difference[seen & level & view.masks["reflective"]])
    assert torch.cat(diffuse).numel() > 300
    assert torch.cat(mirror).numel() > 100
    assert torch.cat(diffuse).median() < 0.03
    assert torch.cat(mirror).median() > 2 * torch.cat(diffuse).median()


def test_points_lie_on_matte_surfaces_that_two_views_see(load: Load) -> None:
    scene = load("diffuse_room")
    points = scene.points[: -len(scene.train)]  # far points come last
    seen_by = torch.zeros(len(points))
    for view in scene.train:
        pixels, depth = view.camera.project(points)
        inside = (depth > 0) & (pixels >= 0).all(1) & (pixels < torch.tensor([64, 48])).all(1)
        column, row = pixels[inside].long().unbind(-1)
        index = inside.nonzero()[:, 0]
        seen_by[index] += ((view.depth[row, column] - depth[inside]).abs() < 0.02 * depth[inside]).float()
    assert len(points) > 1000
    assert (seen_by >= 2).float().mean() > 0.98


def test_points_colors_are_those_of_the_pictures(load: Load) -> None:
    scene = load("diffuse_room")
    view = scene.test[1]
    pixels, depth = view.camera.project(scene.points)
    inside = (depth > 0) & (pixels >= 0).all(1) & (pixels < torch.tensor([64, 48])).all(1)
    column, row = pixels[inside].long().unbind(-1)
    visible = (view.depth[row, column] - depth[inside]).abs() < 0.01 * depth[inside]
    difference = (view.rgb()[row, column] - scene.point_colors[inside])[visible].abs().mean()
    assert visible.sum() > 100
    assert difference < 0.15
    assert scene.point_colors.min() >= 0
    assert scene.point_colors.max() <= 1


def test_point_noise_has_the_asked_deviation(load: Load) -> None:
    views = load("diffuse_room").train
    exact, noisy = (sfm_points(views, noise, 0, np.random.default_rng(0))[0] for noise in (0.0, 0.05))
    difference = noisy - exact
    assert difference.std() == pytest.approx(0.05, rel=0.05)
    assert abs(difference.mean()) < 0.005


def test_mirrors_leave_few_points_and_those_lie_behind_them(load: Load) -> None:
    scene = load("chrome_room")
    on_mirror, ghosts = 0, 0
    for view in scene.train:
        pixels, depth = view.camera.project(scene.points)
        inside = (depth > 0) & (pixels >= 0).all(1) & (pixels < torch.tensor([64, 48])).all(1)
        column, row = pixels[inside].long().unbind(-1)
        there = view.masks["reflective"][row, column]
        offset = (depth[inside] - view.depth[row, column])[there]
        on_mirror += int((offset.abs() < 0.01).sum())
        ghosts += int((offset > 0.05).sum())
    assert ghosts > 0
    assert on_mirror < 0.02 * len(scene.points) * len(scene.train)


def test_points_have_8_bit_colors(load: Load) -> None:
    colors = 255 * load("chrome_room").point_colors
    torch.testing.assert_close(colors, colors.round(), atol=1e-4, rtol=0)


def degrees_between(normals: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
    """Angles [N] where both are known."""
    known = (normals.norm(dim=-1) > 0.5) & (others.norm(dim=-1) > 0.5)
    cosine = (normals[known].double() * others[known].double()).sum(-1)
    return torch.rad2deg(torch.acos(cosine.clamp(-1, 1)))


def test_normal_noise_is_for_training_alone(load: Load) -> None:
    exact, noisy = load("chrome_room"), load("chrome_room", normal_noise=12.0)
    for ours, theirs in zip(exact.test, noisy.test, strict=True):
        assert torch.equal(ours.normal, theirs.normal)
    for ours, theirs in zip(exact.train, noisy.train, strict=True):
        assert torch.equal(ours.image, theirs.image)
        assert torch.equal(ours.depth, theirs.depth)
        assert torch.equal(ours.normal.norm(dim=-1) > 0.5, theirs.normal.norm(dim=-1) > 0.5)
        assert not torch.equal(ours.normal, theirs.normal)
    assert torch.equal(exact.points, noisy.points)
    angles = [degrees_between(a.normal, b.normal) for a, b in zip(exact.train, noisy.train, strict=True)]
    assert torch.cat(angles).mean() == pytest.approx(12, rel=0.2)


@pytest.mark.parametrize("degrees", [2.0, 20.0])
def test_normal_noise_has_the_asked_mean_and_is_smooth(degrees: float) -> None:
    """On a wall that is looked at squarely: Rayleigh's distribution, and neighbors err alike."""
    height, width, rng = 60, 80, np.random.default_rng(3)
    normals = np.broadcast_to([0.0, 0.0, -1.0], (height, width, 3))
    directions = np.broadcast_to([0.0, 0.0, 1.0], (height, width, 3))
    fields = [noisy_normals(normals, directions, degrees, rng) for _ in range(60)]
    angles = np.degrees(np.arccos(np.clip(-np.stack(fields)[..., 2], -1, 1)))
    assert angles.mean() == pytest.approx(degrees, rel=0.1)
    assert np.mean(angles < degrees) == pytest.approx(1 - np.exp(-np.pi / 4), abs=0.06)  # Rayleigh below its mean
    noise = np.stack(fields) - normals
    step = np.linalg.norm(np.diff(noise, axis=2), axis=-1).mean()
    assert step < 0.3 * np.linalg.norm(noise, axis=-1).mean()
    far = np.linalg.norm(noise[:, :, :20] - noise[:, :, -20:], axis=-1).mean()
    assert far > 0.7 * np.linalg.norm(noise, axis=-1).mean()


def test_noisy_normals_face_the_camera_and_stay_unit_or_unknown() -> None:
    rng = np.random.default_rng(0)
    directions = rng.normal((0, 0, 4), 1, (40, 50, 3))
    normals = rng.normal(size=(40, 50, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals *= -np.sign(np.sum(normals * directions, axis=-1, keepdims=True))
    normals[:5] = 0
    noisy = noisy_normals(normals, directions, 25.0, rng)
    assert (noisy[:5] == 0).all()
    np.testing.assert_allclose(np.linalg.norm(noisy[5:], axis=-1), 1, rtol=1e-9)
    assert (np.sum(noisy * directions, axis=-1) <= 1e-9).all()


def test_the_seed_decides_everything(load: Load, tmp_path: Path) -> None:
    def fields(scene: Scene) -> list[torch.Tensor]:
        per_view = [
            (v.image, v.depth, v.normal, v.masks["near_field"], v.camera.world_to_camera) for v in views_of(scene)
        ]
        return [scene.points, scene.point_colors, *(tensor for view in per_view for tensor in view)]

    settings = {**SMALL, "scene": "sky_ball", "width": 16, "height": 16, "views": 4}
    first, second = (load_scene(settings, tmp_path / place) for place in ("a", "b"))
    cached = load_scene(settings, tmp_path / "a")
    assert all(torch.equal(a, b) for a, b in zip(fields(first), fields(second), strict=True))
    assert all(torch.equal(a, b) for a, b in zip(fields(first), fields(cached), strict=True))
    assert cached.name == first.name
    other = load_scene({**settings, "seed": 1}, tmp_path / "a")
    assert not torch.equal(other.train[0].image, first.train[0].image)


def test_a_cached_scene_is_not_made_again(load: Load, monkeypatch: pytest.MonkeyPatch) -> None:
    load("sky_ball")
    monkeypatch.setattr(making, "make_scene", lambda *_: pytest.fail("made again"))
    assert len(load("sky_ball").train) == 14


def test_no_reflective_or_sky_pixels_is_no_obstacle_to_points(load: Load) -> None:
    views = [
        replace(view, masks={"reflective": torch.ones_like(view.depth, dtype=torch.bool)})
        for view in load("diffuse_room").train
    ]
    points, colors = sfm_points(views, 0.01, 3, np.random.default_rng(0))
    assert points.shape == colors.shape
    assert np.isfinite(points).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"scene": "glass_room"}, "dataset.scene='glass_room'.*chrome_room"),
        ({}, "dataset.scene: is missing"),
        ({"scene": "sky_ball", "widht": 64}, "dataset.widht: there is no such key; the keys are .*width"),
        ({"scene": "chrome_room", "width": 10}, "dataset.width=10: Input should be greater than or equal to 16"),
        ({"scene": "chrome_room", "width": 16}, "dataset.height=120: expected at most 5 × dataset.width=16; set both"),
        ({"scene": "sky_ball", "views": 1}, "dataset.views=1"),
        ({"scene": "sky_ball", "noise": float("nan")}, "dataset.noise=nan"),
        ({"scene": "sky_ball", "normal_noise": -3}, "dataset.normal_noise=-3"),
    ],
)
def test_wrong_settings_are_named(tmp_path: Path, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(DatasetError, match=message):
        load_scene({"kind": "toy", **settings}, tmp_path)


@pytest.mark.parametrize("height", [MINIMUM_SIZE, TALLEST * MINIMUM_SIZE])
def test_the_smallest_pictures_that_are_not_refused_can_be_scored(tmp_path: Path, height: int) -> None:
    """Of the scene that is seen at the widest angle: what is refused is refused by its settings."""
    settings = {**SMALL, "scene": "facing_mirrors", "width": MINIMUM_SIZE, "height": height, "views": 4}
    check_scene(load_scene(settings, tmp_path))
