"""Path-traced toy scenes: Mitsuba's pictures against our own tracer's where both agree, and against closed forms."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import torch
from toy_scenes import coarse_toys

from envgs_bench.core import Camera
from envgs_bench.datasets import DatasetError, load_scene, path_tracer, progress
from envgs_bench.datasets.formats.srgb import to_linear
from envgs_bench.datasets.registry import check_source
from envgs_bench.datasets.toy import path_traced
from envgs_bench.datasets.toy.cameras import look_at
from envgs_bench.datasets.toy.path_traced import PathTraced
from envgs_bench.datasets.toy.render import geometry, picture
from envgs_bench.datasets.toy.shapes import Rectangle, Shape, Sphere, box
from envgs_bench.datasets.toy.world import Part, World

WHITE = np.ones((4, 8, 3))
CENTERS = [(2.5, 1.0, 1.5), (-2.0, 2.0, 0.7)]
TINY = {"kind": "toy", "scene": "copper_table", "width": 24, "height": 18, "views": 3, "supersampling": 2}


def camera_of(center: tuple[float, float, float], width: int = 64, height: int = 48) -> Camera:
    """As toy scenes have them: square pixels, the principal point in the middle."""
    pose = torch.from_numpy(look_at(np.array(center), np.zeros(3))).float()
    intrinsics = torch.tensor([[1.1 * width, 0, width / 2], [0, 1.1 * width, height / 2], [0, 0, 1]])
    return Camera(pose, intrinsics, width, height)


def patches(rows: int, columns: int, seed: int) -> np.ndarray:
    coarse = np.random.default_rng(seed).uniform(0.1, 0.9, (rows, columns, 3))
    return np.repeat(np.repeat(coarse, 16, axis=0), 16, axis=1)


def shining(shape: Shape, radiance: np.ndarray) -> Part:
    """What sends out this light and reflects hardly any."""
    return Part(shape, 1e-4 * radiance, emission=1e4)


def shining_box() -> list[Part]:
    return [shining(face, patches(4, 4, index)) for index, face in enumerate(box((0, 0, -0.5), (1, 1, 1), 25))]


def both(parts: list[Part], sky: np.ndarray, camera: Camera, metals: tuple[Part, ...] = ()) -> tuple[np.ndarray, ...]:
    """The world's picture as our own tracer makes it, and as Mitsuba does, with `metals` in place of our mirrors."""
    world = World(parts, sky)
    world.set_textures([part.emission * part.albedo for part in parts])
    diffuse = [part for part in parts if not part.reflectance]
    ours = picture(world, camera, 8, np.random.default_rng(0))
    return ours, PathTraced([*diffuse, *metals], sky).picture(camera, 8, np.random.default_rng(0))


def psnr(ours: np.ndarray, theirs: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean(((ours.astype(float) - theirs) / 255) ** 2)))


@pytest.mark.parametrize("center", CENTERS)
def test_both_tracers_see_one_world(center: tuple[float, float, float]) -> None:
    """What shines by itself before a sky: all that a wrong axis or a texture upside down would move."""
    ours, theirs = both(shining_box(), patches(8, 16, 9), camera_of(center))
    assert psnr(ours, theirs) > 30
    assert psnr(ours, theirs[:, ::-1]) < 20


@pytest.mark.parametrize("center", CENTERS)
def test_silver_is_our_mirror_of_its_reflectance(center: tuple[float, float, float]) -> None:
    parts = shining_box()
    ball, blank = Sphere((0.2, 0.9, 0.1), 0.6), np.zeros((1, 1, 3))
    mirror, silver = Part(ball, blank, reflectance=0.96), Part(ball, blank, metal="Ag")
    ours, theirs = both([*parts, mirror], patches(8, 16, 9), camera_of(center), (silver,))
    assert psnr(ours, theirs) > 28
    assert psnr(ours, both(parts, patches(8, 16, 9), camera_of(center))[0]) < 22


def test_a_coat_reflects_what_fresnel_says() -> None:
    """Of a white sky, over black, by the angle at which each pixel looks at the floor."""
    floor = Part(Rectangle((-50, 50, 0), (100, 0, 0), (0, -100, 0)), np.full((1, 1, 3), 1e-6), coat=1.5)
    traced = PathTraced([floor], WHITE)
    for center in ((0.001, 0, 9), (6, 0, 3), (9, 0, 1)):
        camera = camera_of(center, 16, 12)
        directions = camera.rays()[1].double().numpy()
        cosine = -directions[..., 2] / np.linalg.norm(directions, axis=-1)
        refracted = np.sqrt(1 - (1 - cosine**2) / 1.5**2)
        across = (cosine - 1.5 * refracted) / (cosine + 1.5 * refracted)
        along = (1.5 * cosine - refracted) / (1.5 * cosine + refracted)
        expected = (across**2 + along**2) / 2
        found = to_linear(traced.picture(camera, 8, np.random.default_rng(0)) / 255.0).mean(axis=-1)
        sees = cosine > 0.04  # the floor, and less than half a pixel from where it ends
        assert np.abs(found - expected)[sees].max() < 0.03


def test_regions_part_all_surfaces() -> None:
    balls = [Sphere((0.0, y, 0.0), 0.4) for y in (-0.9, 0.0, 0.9)]
    gray = np.full((1, 1, 3), 0.5)
    parts = [Part(balls[0], gray, metal="Cu"), Part(balls[1], gray, coat=1.5), Part(balls[2], gray)]
    exact = geometry(World(parts, WHITE), camera_of((3, 0, 0)))
    mirror, coated, diffuse = (exact.regions[name] for name in ("mirror", "coated", "diffuse"))
    assert (mirror.sum(), coated.sum(), diffuse.sum()) > (50, 50, 50)
    assert np.array_equal(mirror.astype(int) + coated + diffuse, exact.depth > 0)
    assert np.array_equal(mirror | coated, exact.regions["reflective"])


@pytest.mark.parametrize("name", ["copper_table", "brushed_patio"])
def test_a_scene_is_made_the_same_each_time(tmp_path: Path, name: str) -> None:
    with coarse_toys():
        once, again = (load_scene({**TINY, "scene": name}, tmp_path / folder) for folder in ("a", "b"))
    for ours, theirs in zip(once.train, again.train, strict=True):
        assert torch.equal(ours.image, theirs.image)
        assert set(ours.masks) == {"reflective", "near_field", "mirror", "coated", "diffuse"}
    assert torch.equal(once.points, again.points)


def test_without_mitsuba_it_is_said_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with coarse_toys(), pytest.raises(DatasetError, match=r"pip install 'envgs-bench\[mitsuba\]'"):
        load_scene(TINY, tmp_path)


def test_a_gpu_is_told_to_trace_by_one_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Here the CPU takes its place: what it is asked for is the same scene, kept apart from the CPU's own."""
    told, threads, together = [], set(), threading.Barrier(3, timeout=60)

    class Recorded(path_tracer.PathTracer):
        def __init__(
            self, surfaces: list[path_tracer.TracedSurface], sky: np.ndarray, tracer: path_tracer.Tracer
        ) -> None:
            told.append(tracer)
            super().__init__(surfaces, sky)

        def light(self, camera: Camera, supersampling: int, seed: int) -> np.ndarray:
            threads.add(threading.get_ident())
            if told == ["cpu"]:
                together.wait()  # for one thread a view, or the quickest might take two
            return super().light(camera, supersampling, seed)

    monkeypatch.setattr(path_traced, "PathTracer", Recorded)
    monkeypatch.setattr(progress.os, "cpu_count", lambda: 3)
    with coarse_toys():
        ours = load_scene(TINY, tmp_path)
        assert (told, len(threads)) == (["cpu"], 3)
        threads.clear()
        load_scene({**TINY, "tracer": "cpu"}, tmp_path)  # which is cached
        theirs = load_scene({**TINY, "tracer": "gpu"}, tmp_path)
    assert (told, len(threads)) == (["cpu", "gpu"], 1)
    assert len(list((tmp_path / "scenes").iterdir())) == 2
    for one, other in zip((*ours.train, *ours.test), (*theirs.train, *theirs.test), strict=True):
        assert torch.equal(one.image, other.image)


def test_without_such_a_gpu_it_is_said_what_to_give(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    with coarse_toys(), pytest.raises(DatasetError, match=r"dataset\.tracer=cpu"):
        load_scene({**TINY, "tracer": "gpu"}, tmp_path)


def test_no_gpu_traces_what_mitsuba_does_not(tmp_path: Path) -> None:
    given = {**TINY, "scene": "chrome_room", "tracer": "gpu"}
    told = r"dataset\.tracer='gpu': chrome_room is ray-traced, .* give dataset\.tracer=cpu, or .* brushed_patio"
    with pytest.raises(DatasetError, match=told):
        check_source(given)
    with pytest.raises(DatasetError, match=told):
        load_scene(given, tmp_path)
