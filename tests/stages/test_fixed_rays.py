"""Samples of a finished model along fixed rays: the same rays for every seed, mirrored where the true scene mirrors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, Rendering, Scene
from envgs_bench.fixed_rays import FixedRaySamples, read_samples_if_any, write_samples
from envgs_bench.methods.registry import create_method
from envgs_bench.parts import REFLECTIVE
from envgs_bench.stages.fixed_rays import OFFSET, REFLECTED, FixedRays
from envgs_bench.testing import tiny_scene


class Records:
    """Draws what any method draws, and notes which reflected rays it was asked for."""

    device = torch.device("cpu")

    def __init__(self, scene: Scene) -> None:
        self.method = create_method("2dgs")
        self.method.initialize(scene, 1)
        self.monitor = self

    def render(self, camera: Camera) -> Rendering:
        return self.method.render(camera)

    def reflected(self, origins: Tensor, directions: Tensor) -> Tensor:
        self.rays = origins, directions
        return 0.5 + directions / 2


def sampled(method: Any, scene: Scene) -> FixedRaySamples:
    """Samples of a method whose renderings of the test views, and of others, are looked at."""
    rays = FixedRays(scene.test)
    for view in (*scene.train, *scene.test):
        rays.see(view, method.render(view.camera))
    return rays.samples(method, scene.radius)


def before_a_mirror() -> Scene:
    """The tiny scene with a mirror in the plane through the world's origin that its test camera looks at squarely, but
    for the left column of pixels."""
    scene = tiny_scene()
    (view,) = scene.test
    facing = functional.normalize(view.camera.center, dim=0)
    shape = (view.camera.height, view.camera.width)
    mirror = torch.ones(shape, dtype=torch.bool)
    mirror[:, 0] = False
    depth = torch.full(shape, float(view.camera.center.norm()))
    return replace(
        scene, test=[replace(view, masks={REFLECTIVE: mirror}, normal=facing.expand(*shape, 3), depth=depth)]
    )


def test_a_plane_mirror_sends_rays_as_from_the_cameras_mirror_image() -> None:
    scene = before_a_mirror()
    (view,) = scene.test
    method = Records(scene)
    found = sampled(method, scene)
    origins, directions = method.rays
    count = view.camera.height * (view.camera.width - 1)
    assert len(origins) == min(count, REFLECTED)
    torch.testing.assert_close(directions.norm(dim=1), torch.ones(len(origins)))
    facing = functional.normalize(view.camera.center, dim=0)
    torch.testing.assert_close(origins @ facing, torch.full((len(origins),), OFFSET * scene.radius), atol=1e-5, rtol=0)
    from_image = functional.normalize(origins + view.camera.center, dim=1)  # the mirror image of the camera is −center
    torch.testing.assert_close(directions, from_image, atol=2e-3, rtol=0)
    np.testing.assert_array_equal(found.reflected, (0.5 + directions / 2).numpy())


def test_seeds_are_sampled_along_the_same_rays_and_files_are_small(tmp_path: Path) -> None:
    scene = before_a_mirror()
    first, second = Records(scene), Records(scene)
    second.method.generator.manual_seed(7)
    written = sampled(first, scene)
    again = sampled(second, scene)
    torch.testing.assert_close(first.rays, second.rays, atol=0, rtol=0)
    write_samples(tmp_path, written)
    stored = read_samples_if_any(tmp_path)
    assert (tmp_path / "fixed_rays.safetensors").stat().st_size < 60_000
    assert stored.radius == pytest.approx(scene.radius)
    np.testing.assert_array_equal(stored.depth, again.depth)
    np.testing.assert_allclose(stored.normal, again.normal, atol=1e-3)
    np.testing.assert_allclose(stored.reflected, again.reflected, atol=1e-3)
    assert np.linalg.norm(stored.normal, axis=1).max() == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize(("kind", "traces"), [("2dgs", False), ("envmap", True), ("envgs", True)])
def test_methods_with_reflections_say_what_rays_see(kind: str, traces: bool) -> None:
    settings = {"2dgs": {}, "envmap": {"envmap_size": 16}, "envgs": {"env_grid": 3, "env_far_count": 30}}[kind]
    scene = before_a_mirror()
    method = create_method(kind, settings)
    method.initialize(scene, 30_000)
    assert sampled(method, scene).reflected is None  # reflections have not begun
    method.initialize(scene, 1)
    method.training_step(scene.train[0], 1)
    found = sampled(method, scene).reflected
    assert (found is not None) == traces
    if found is not None:
        assert found.std() > 0 or kind == "envmap"  # the map is gray as yet
    assert sampled(method, tiny_scene()).reflected is None  # it is not known what reflects
