"""What the core's calls refuse before a backend is asked, with the same words for all of them."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from core_scenes import Backend, facing_surfels, plain_camera, random_rays, random_set
from torch import Tensor

from envgs_bench.core import Camera, Rendering, depth_normals, rasterize, rasterize_color, reflect, trace, trace_color
from envgs_bench.core.ssim import ssim_map

BACKENDS = pytest.mark.parametrize("backend", ["cpu", "cuda", "torch"])


def double(camera: Camera) -> Camera:
    return camera.to(torch.float64)


def drawn(camera: Camera) -> Rendering:
    """A β-carrying image of this camera's, float32, on the CPU."""
    with torch.no_grad():
        return rasterize(random_set(60, seed=1), camera, backend="torch")


@BACKENDS
@pytest.mark.parametrize("columns", [2, 3])
@pytest.mark.parametrize("draw", [rasterize, rasterize_color])
def test_a_camera_of_another_dtype_is_refused(backend, draw, columns):
    with pytest.raises(
        ValueError, match=r"camera is torch.float64 on cpu, gaussians torch.float32 on cpu: convert one"
    ):
        draw(random_set(9, columns=columns), double(plain_camera()), backend=backend)
    mixed = replace(plain_camera(), intrinsics=plain_camera().intrinsics.double())
    with pytest.raises(
        ValueError, match=r"camera is torch.float64 on cpu, gaussians torch.float32 on cpu: convert one"
    ):
        draw(random_set(9, columns=columns), mixed, backend=backend)


@BACKENDS
def test_normals_of_a_depth_map_of_another_dtype_are_refused(backend):
    with pytest.raises(ValueError, match=r"camera is torch.float64 on cpu, depth torch.float32 on cpu: convert one"):
        depth_normals(torch.ones(33, 33), double(plain_camera()), backend=backend)


@BACKENDS
def test_similarity_to_a_target_of_another_dtype_is_refused(backend):
    image = torch.rand(16, 16, 3)
    with pytest.raises(ValueError, match=r"target is torch.float64 on cpu, image torch.float32 on cpu: convert one"):
        ssim_map(image, image.double(), backend=backend)


@BACKENDS
@pytest.mark.parametrize(
    ("change", "beta_min", "message"),
    [
        (
            {"camera": plain_camera(16, 16)},
            0.0,
            r"image.alpha is torch.float32 \(33, 33\) on cpu, expected .*\(16, 16\)",
        ),
        ({"camera": double(plain_camera())}, 0.0, "camera is torch.float64 on cpu, image torch.float32 on cpu"),
        ({"depth": torch.ones(33, 33).double()}, 0.0, "image.depth is torch.float64"),
        ({"normal": torch.ones(33, 33)}, 0.0, r"image.normal is torch.float32 \(33, 33\) .* expected .*\(33, 33, 3\)"),
        ({"extras": torch.ones(33, 33, 0)}, 0.0, r"image.extras is torch.float32 \(33, 33, 0\)"),
        ({}, torch.tensor([0.1]).double(), "beta_min is torch.float64"),
        ({}, torch.tensor([0.1, 0.2]), r"beta_min is torch.float32 \(2,\) on cpu, expected a number, or one value of"),
    ],
)
def test_an_image_that_is_not_the_cameras_reflects_nothing(backend, change, beta_min, message):
    camera = change.get("camera", plain_camera())
    fields = {name: value for name, value in change.items() if name != "camera"}
    image = replace(drawn(plain_camera()), **fields)
    with pytest.raises(ValueError, match=message):
        reflect(image, camera, beta_min=beta_min, backend=backend)


@BACKENDS
@pytest.mark.parametrize("distance", [-0.1, float("nan")])
def test_what_lies_behind_is_not_drawn(backend, distance):
    surfels, rays = random_set(9), random_rays(5)
    for draw in (rasterize, rasterize_color):
        with pytest.raises(ValueError, match=r"near is .*, expected 0 or more"):
            draw(surfels, plain_camera(), near=distance, backend=backend)
    for draw in (trace, trace_color):
        with pytest.raises(ValueError, match=r"t_min is .*, expected 0 or more"):
            draw(surfels, *rays, t_min=distance, backend=backend)


@BACKENDS
@pytest.mark.parametrize("threshold", [-0.1, 1.1, float("nan")])
def test_an_image_wants_a_threshold_that_is_a_transmittance(backend, threshold):
    with pytest.raises(ValueError, match=r"transmittance_min is .*, expected a number from 0 to 1"):
        rasterize(random_set(9), plain_camera(), transmittance_min=threshold, backend=backend)


def along_z(tracer: Backend, z: float) -> tuple[Tensor, Tensor]:
    return tracer.take(torch.tensor([[0.0, 0.0, z]])), tracer.take(torch.tensor([[0.0, 0.0, 1.0]]))


@pytest.mark.parametrize("t_min", [0.0, -0.0])
def test_a_hit_at_the_rays_origin_is_drawn(tracer, t_min):
    """Two surfels, the ray begins on the first."""
    surfels = tracer.take(facing_surfels(torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, 3.0]])))
    traced = tracer.trace(surfels, *along_z(tracer, 2.0), t_min=t_min)
    assert traced.hits.item() == 2
    assert traced.alpha.item() == pytest.approx(0.75, abs=1e-5)
    assert traced.depth.item() == pytest.approx(1 / 3, abs=1e-5)  # (0.5 · 0 + 0.25 · 1) / 0.75


@pytest.mark.parametrize("threshold", [1.5, float("nan")])
def test_a_ray_that_has_ended_before_its_first_hit_draws_nothing(tracer, threshold):
    """More hits than a GPU's list holds, one of the two rays as ever."""
    count = 80
    means = torch.stack([torch.zeros(count), torch.zeros(count), 2 + 0.01 * torch.arange(count)], 1)
    surfels = tracer.take(facing_surfels(means, opacity=0.02))
    origins, directions = (tracer.take(x.detach().expand(2, 3)) for x in along_z(tracer, 0.0))
    ends = torch.tensor([threshold, 0.0]).to(origins)
    traced = tracer.trace(surfels, origins, directions, transmittance_min=ends)
    assert traced.hits.tolist() == [0, count]
    assert traced.alpha[0] == 0
    assert traced.alpha[1].item() == pytest.approx(1 - 0.98**count, rel=1e-4)
    traced.color.sum().backward()
    assert surfels.opacities.grad is not None
    assert surfels.opacities.grad.isfinite().all()


@pytest.mark.parametrize("columns", [2, 3])
def test_position_gradients_need_means_that_require_a_gradient(rasterizer, columns):
    gaussians, camera = rasterizer.take(random_set(30, columns=columns)), rasterizer.take(plain_camera())
    for means in (gaussians.means.detach(), gaussians.means):
        image = rasterizer.rasterize(replace(gaussians, means=means), camera)
        assert image.statistics.position_gradients is None
        image.color.sum().backward()
        assert (image.statistics.position_gradients is not None) == means.requires_grad


def test_position_gradients_of_rays_need_means_that_require_a_gradient(tracer):
    surfels, rays = tracer.take(random_set(30)), [tracer.take(x) for x in random_rays(20)]
    for means in (surfels.means.detach(), surfels.means):
        traced = tracer.trace(replace(surfels, means=means), *rays)
        traced.color.sum().backward()
        assert (traced.statistics.position_gradients is not None) == means.requires_grad
