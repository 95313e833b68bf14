"""Sampled scenes: what the distribution says, truth against closed forms, and that a seed is a scene."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from envgs_bench.core import Camera
from envgs_bench.datasets import DatasetError, load_scene
from envgs_bench.datasets.notes import collecting
from envgs_bench.datasets.path_tracer import PathTracer
from envgs_bench.datasets.sampled import distribution, light, patterns, pictures
from envgs_bench.datasets.sampled.distribution import one_of
from envgs_bench.datasets.sampled.making import drawn
from envgs_bench.datasets.sampled.materials import MIRROR, Surface, drawn_material
from envgs_bench.datasets.sampled.place import flat, four_walls
from envgs_bench.datasets.sampled.places import PLACES
from envgs_bench.datasets.sampled.settings import SampledSettings
from envgs_bench.datasets.sampled.solids import Knot, Lump, Superellipsoid, blobs
from envgs_bench.datasets.sampled.truth import TruthOf
from envgs_bench.datasets.toy.cameras import look_at
from envgs_bench.datasets.toy.shapes import Shape, Sphere, tessellate

TINY = {"kind": "sampled", "width": 32, "height": 24, "views": 10, "supersampling": 1}


@pytest.fixture(autouse=True)
def _coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Textures and skies of few texels, and small pictures to find the exposure by: a tenth of the time."""
    monkeypatch.setattr(light, "ROWS", 48)
    monkeypatch.setattr(light, "COLUMNS", 96)
    monkeypatch.setattr(patterns, "MOST_TEXELS", 48)
    monkeypatch.setattr(pictures, "PROBE_WIDTH", 16)


def camera_at(center: tuple[float, float, float], target: tuple[float, float, float] = (0, 0, 0)) -> Camera:
    pose = torch.from_numpy(look_at(np.array(center, float), np.array(target, float))).float()
    return Camera(pose, torch.tensor([[40.0, 0, 20], [0, 40, 15], [0, 0, 1]]), 40, 30)


def test_shares_are_drawn_as_they_are_written() -> None:
    rng = np.random.default_rng(0)
    names = [one_of(rng, distribution.PLACES) for _ in range(4000)]
    for name, share in distribution.PLACES.items():
        assert abs(names.count(name) / 4000 - share / sum(distribution.PLACES.values())) < 0.03


def test_every_place_of_the_distribution_can_be_drawn() -> None:
    assert set(distribution.PLACES) == set(PLACES)
    for name, place in PLACES.items():
        drawn_place = place(np.random.default_rng(3))
        assert drawn_place.name == name
        assert len(drawn_place.surfaces) > 8
        assert np.isfinite(drawn_place.sky).all()
        assert (drawn_place.sky >= 0).all()


@pytest.mark.parametrize(
    "shape",
    [
        Superellipsoid((0.1, 0.2, 0.3), (0.5, 0.3, 0.2), 3.0, 30.0),
        Lump((0.0, 0.0, 0.5), 0.4, ((0.1, (2.0, 1.0, 0.5), 0.3), (0.05, (-3.0, 2.0, 4.0), 1.0)), 0.7),
        Knot((0.0, 0.0, 0.0), 0.5, 0.07, (2, 3)),
    ],
)
def test_normals_are_those_of_the_surface(shape: Shape) -> None:
    """Across both finite differences, and outward as the lattice's triangles are."""
    rng = np.random.default_rng(0)
    u, v = rng.uniform(0.05, 0.95, 200), rng.uniform(0.1, 0.9, 200)
    step = 1e-5
    normals = shape.evaluate(u, v)[1]
    for du, dv in ((step, 0.0), (0.0, step)):
        along = shape.evaluate(u + du, v + dv)[0] - shape.evaluate(u - du, v - dv)[0]
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        assert np.abs((along * normals).sum(-1)).max() < 2e-3


def test_blobs_of_one_ball_are_the_ball() -> None:
    mesh = tessellate(blobs(np.array([[0.2, 0.0, 0.1]]), np.array([0.5]), 48))
    radius = np.linalg.norm(mesh.vertices - [0.2, 0.0, 0.1], axis=1)
    assert np.abs(radius - 0.5).max() < 0.01
    corners = mesh.vertices[mesh.faces]
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((faces * mesh.normals[mesh.faces[:, 0]]).sum(1) > 0).all()


def test_truth_of_a_mirror_says_what_it_mirrors() -> None:
    """A mirror on the ground under a ball: the ball where a ray from its image would pass through the ball."""
    ball = Surface(Sphere((0.0, 0.0, 0.8), 0.3), thing=2)
    truth = TruthOf([Surface(flat((0, 0, 0), 4, 4), MIRROR, thing=1), ball])(camera_at((2.0, 0.0, 1.2), (0, 0, -0.3)))
    origins, directions = (rays.double().numpy() for rays in camera_at((2.0, 0.0, 1.2), (0, 0, -0.3)).rays())
    image = np.array([0.0, 0.0, -0.8])  # the ball's center, mirrored
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    nearest = np.linalg.norm(np.cross(image - origins, unit), axis=-1)
    sure = truth.regions["mirror"] & (np.abs(nearest - 0.3) > 0.01)
    assert np.array_equal(truth.regions["near_field"][sure], (nearest < 0.3)[sure])
    assert np.array_equal(truth.regions["far_field"][sure], (nearest > 0.3)[sure])
    assert truth.regions["near_field"].sum() > 20
    assert not truth.regions["self_field"].any()
    assert (truth.regions["diffuse"] | truth.regions["mirror"] == (truth.depth > 0)).all()


@pytest.mark.parametrize("name", ["diffuse", *distribution.MATERIALS])
def test_no_material_gives_more_light_than_it_gets(name: str) -> None:
    """In a white furnace a pixel is at most white, and a surface of white paint or glass hardly darker."""
    rng = np.random.default_rng(1)
    ball = Surface(Sphere((0.0, 0.0, 0.0), 0.8), drawn_material(rng, name), np.full((2, 2, 3), 0.9))
    found = PathTracer([ball.traced()], np.ones((4, 8, 3))).light(camera_at((2.0, 0.3, 0.4)), 4, 0)
    middle = found[10:20, 15:25]
    assert middle.mean() < 1.02
    assert middle.mean() > 0.3


def test_a_path_counts_for_no_more_than_it_may() -> None:
    floor = Surface(flat((0, 0, 0), 4, 4), thing=1)
    sky = np.ones((4, 8, 3))
    sky[0] = 400.0
    tracer, rng = PathTracer([floor.traced()], sky), np.random.default_rng(1)
    (view,) = tracer.clamped_lights([camera_at((2.0, 0.0, 1.2))], 2, 0.7, rng)
    assert view.max() <= 0.7 + 1e-6
    assert view.shape == (30, 40, 3)


def test_views_traced_at_once_are_those_traced_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a GPU traces them: a glowing floor from three sides, black around it, has no noise but along its edges."""
    floor = Surface(flat((0.3, 0.1, 0), 1.5, 1), linear=np.full((2, 2, 3), 0.5), emission=1.0)
    tracer = PathTracer([floor.traced()], np.zeros((4, 8, 3)))
    cameras = [camera_at(center) for center in ((2.0, 0.0, 1.2), (0.0, 2.0, 1.0), (-1.5, -1.0, 0.8))]
    alone = list(tracer.clamped_lights(cameras, 4, 1.0, np.random.default_rng(0)))
    monkeypatch.setattr(tracer, "_views_at_once", lambda *_: 2)
    together = list(tracer.clamped_lights(cameras, 4, 1.0, np.random.default_rng(1)))
    assert len(together) == 3
    for one, other in zip(alone, together, strict=True):
        assert other.shape == (30, 40, 3)
        assert np.abs(one - other).mean() < 0.003
    assert np.abs(alone[0] - alone[1]).mean() > 0.03  # the views differ


def test_a_seed_is_a_scene_and_its_pictures_may_come_from_an_archive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    once = load_scene({**TINY, "seed": 3}, tmp_path / "a")
    (archive,) = (tmp_path / "a" / "pictures").iterdir()
    assert len(zipfile.ZipFile(archive).namelist()) == len(once.train) + len(once.test)
    (tmp_path / "b" / "pictures").mkdir(parents=True)
    (tmp_path / "b" / "pictures" / archive.name).write_bytes(archive.read_bytes())
    monkeypatch.setitem(sys.modules, "mitsuba", None)  # nothing is to be traced
    again = load_scene({**TINY, "seed": 3}, tmp_path / "b")
    for ours, theirs in zip([*once.train, *once.test], [*again.train, *again.test], strict=True):
        assert torch.equal(ours.image, theirs.image)
        assert torch.equal(ours.normal, theirs.normal)  # type: ignore[arg-type]
    assert torch.equal(once.points, again.points)
    assert once.attributes == again.attributes
    assert 0 <= once.attributes["reflective"] <= 1
    shares = ("near_field", "self_field", "far_field")
    assert sum(once.attributes[name] for name in shares) == pytest.approx(float(once.attributes["reflective"] > 0))
    with pytest.raises(DatasetError, match="not installed"):
        load_scene({**TINY, "seed": 4}, tmp_path / "b")


def test_pictures_that_took_an_hour_are_not_lost_where_they_cannot_be_kept(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    traced = [np.zeros((2, 2, 3), np.uint8)]
    with collecting() as notes:
        assert pictures.kept_pictures(tmp_path / "file/sampled.zip", 1, lambda: traced) is traced
    assert notes[0].startswith(f"traced pictures could not be kept in {tmp_path / 'file'}: ")


def test_views_where_nobody_stood_change_no_other(tmp_path: Path) -> None:
    plain, more = (load_scene({**TINY, "seed": 3, **given}, tmp_path) for given in ({}, {"unseen": 2}))
    archives = {path.stem.rpartition("-")[2]: path for path in (tmp_path / "pictures").iterdir()}
    assert sorted(len(zipfile.ZipFile(path).namelist()) for path in archives.values()) == [10, 14]
    assert not plain.unseen
    assert {place: len(views) for place, views in more.unseen.items()} == {"between": 2, "beyond": 2}
    for one, other in zip((*plain.train, *plain.test), (*more.train, *more.test), strict=True):
        assert torch.equal(one.image, other.image)
    for place, views in more.unseen.items():
        for view in views:
            assert view.name.startswith(place)
            assert view.image.float().mean() > 1  # they are pictures of the place
            assert "covisible" in view.masks


def test_without_such_a_gpu_it_is_said_what_to_give(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    with pytest.raises(DatasetError, match=r"dataset\.tracer=cpu"):
        load_scene({**TINY, "tracer": "gpu"}, tmp_path)


def test_cameras_stand_clear_of_all_things() -> None:
    """But for what cannot be helped, one in twenty."""
    near, cameras = 0, 0
    for seed in range(4):
        scene = drawn(SampledSettings(kind="sampled", seed=seed, width=32, height=24, views=16))
        for camera in scene.cameras:
            depth = scene.truth(camera).depth
            near += bool(((depth > 0) & (depth < 0.1)).mean() > 0.2)
        cameras += len(scene.cameras)
    assert near <= cameras / 20


def test_walls_close_a_room() -> None:
    walls = four_walls((2.0, 3.0), 2.5)
    assert [round(float(np.linalg.norm(wall.middle)), 6) for wall in walls] == [3.0, 2.0, 3.0, 2.0]
    for wall in walls:
        assert float(wall.middle @ wall.inward) < 0
        assert float(wall.along @ wall.inward) == 0
