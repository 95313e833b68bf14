"""The backends against the float64 oracle and against each other: every field, every gradient."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from backends import EMULATED, usable
from core_scenes import (
    FIELDS,
    ORACLE,
    Backend,
    facing_surfels,
    gradients_of,
    loss_of,
    random_rays,
    random_set,
    rasterized,
    relative_error,
    steady,
    tilted_camera,
    traced,
)
from oracle import (
    BACKGROUND,
    CAMERA,
    SCENES,
    SINGLE,
    TOLERANCE,
    compare,
    compare_image_color,
    compare_ray_color,
    drawn_with,
    image,
    oracle_image,
    oracle_ray_batch,
    ray_batch,
    threads_of,
)
from scipy.spatial.transform import Rotation

from envgs_bench.core import GaussianSet


@pytest.fixture(params=["cpu", "cuda", "torch", EMULATED])
def single(request: pytest.FixtureRequest) -> Backend:
    """The backends in float32, the oracle's own float32 among them."""
    return SINGLE if request.param == "torch" else usable(request)


@pytest.mark.parametrize(
    ("scene", "low_pass"),
    [*((scene, True) for scene in SCENES), *((scene, False) for scene in ("many", "tiny", "elongated"))],
)
@pytest.mark.parametrize("as_gaussians_3d", [False, True], ids=["surfels", "gaussians_3d"])
def test_images(single, scene, as_gaussians_3d, low_pass):
    gaussians, keep, expected = oracle_image(scene, as_gaussians_3d, low_pass)
    compare(drawn_with(single, gaussians, image(low_pass), keep, ()), expected, keep)


@pytest.mark.parametrize("as_gaussians_3d", [False, True], ids=["surfels", "gaussians_3d"])
@pytest.mark.parametrize("scene", list(SCENES))
def test_colors_of_images_alone(single, scene, as_gaussians_3d):
    compare_image_color(single, scene, as_gaussians_3d)


BATCHES = pytest.mark.parametrize(
    ("scene", "sh_direction"),
    [
        *((scene, "center") for scene in SCENES),
        *((scene, "ray") for scene in ("many", "degree-1", "degree-3", "sites")),
    ],
)


@BATCHES
def test_ray_batches(single, scene, sh_direction):
    gaussians, rays, expected = oracle_ray_batch(scene, sh_direction)
    keep = torch.ones(len(rays[0])) > 0
    compare(drawn_with(single, gaussians, ray_batch(sh_direction), keep, rays), expected, keep)


@BATCHES
def test_colors_of_rays_alone(single, scene, sh_direction):
    compare_ray_color(single, scene, sh_direction)


@pytest.mark.parametrize("scene", list(SCENES))
def test_embree_finds_the_same_hits(scene):
    """In float64, hit for hit, without leaving any ray out."""
    gaussians, rays, keep = SCENES[scene], random_rays(1000), torch.ones(1000) > 0
    one, other = (drawn_with(each, gaussians, ray_batch(), keep, rays) for each in (Backend.named("embree"), ORACLE))
    compare(one, other, keep)


def test_natively_traced_rays_against_embree(native):
    gaussians, (origins, directions) = SCENES["many"], random_rays(1000)
    keep = steady(gaussians, traced(gaussians, origins, directions))
    embree = Backend.named("embree")
    fast, slow = (
        each.trace(*(each.take(x) for x in (gaussians, origins[keep], directions[keep]))) for each in (native, embree)
    )
    assert torch.equal(fast.hits.cpu(), slow.hits)
    for name in FIELDS:
        assert relative_error(getattr(fast, name), getattr(slow, name)) < TOLERANCE / 10, name


def slabs(count: int = 12) -> GaussianSet:
    """Tilted surfels, each alone in a slab of the camera's depth, so that hits and centers sort alike."""
    camera = tilted_camera()
    generator = torch.Generator().manual_seed(0)
    in_camera = torch.stack(
        [
            0.8 * torch.rand(count, generator=generator) - 0.4,
            0.8 * torch.rand(count, generator=generator) - 0.4,
            1.5 + 0.6 * torch.arange(count),
        ],
        dim=1,
    )
    axis = torch.nn.functional.normalize(torch.randn(count, 2, generator=generator), dim=1)
    half = 0.25 * torch.rand(count, generator=generator)  # tilted by up to half a radian
    tilt = torch.cat([half.cos()[:, None], half.sin()[:, None] * axis, torch.zeros(count, 1)], dim=1)
    rotation = camera.world_to_camera[:3, :3]
    means = (in_camera - camera.world_to_camera[:3, 3]) @ rotation
    to_world = Rotation.from_matrix(rotation.T.double().numpy()) * Rotation.from_quat(tilt.numpy(), scalar_first=True)
    shuffled = torch.randperm(count, generator=generator)
    base = random_set(count, degree=3, extras=2)
    return replace(
        base,
        means=means,
        quaternions=torch.from_numpy(to_world.as_quat(scalar_first=True)).float(),
        scales=torch.full((count, 2), 0.19),
        opacities=0.3 + 0.6 * torch.rand(count, generator=generator),
    ).map(lambda x: x[shuffled])


def test_tracing_a_cameras_rays_is_its_raster_image(rasterizer):
    """The two sort by different depths and find hits in different ways; nothing else may differ."""
    gaussians, camera = slabs(), CAMERA
    keep = steady(gaussians, rasterized(gaussians, camera, low_pass=False))
    assert keep.double().mean() > 0.9
    leaves, view = rasterizer.take(gaussians), rasterizer.take(camera)
    origins, directions = (rays.to(rasterizer.dtype) for rays in view.rays())
    image = rasterizer.rasterize(leaves, view, low_pass=False, background=BACKGROUND)
    rays = rasterizer.trace(leaves, origins, directions, t_min=0.2, background=BACKGROUND)

    where = keep.to(image.alpha.device)
    assert torch.equal(image.hits[where], rays.hits[where])
    assert image.hits.max() >= 4
    for name in FIELDS:
        torch.testing.assert_close(getattr(image, name)[where], getattr(rays, name)[where], atol=1e-4, rtol=0)

    by_raster = torch.autograd.grad(loss_of(image, keep), list(vars(leaves).values()))
    by_rays = torch.autograd.grad(loss_of(rays, keep), list(vars(leaves).values()))
    for name, one, other in zip(vars(leaves), by_raster, by_rays, strict=True):
        assert relative_error(one, other) < TOLERANCE, name


@pytest.mark.parametrize("columns", [2, 3])
def test_two_images_are_bitwise_equal(rasterizer, columns):
    scene, camera = random_set(400, columns=columns), rasterizer.take(CAMERA)
    check_repeats(rasterizer, scene, lambda leaves: rasterizer.rasterize(leaves, camera))


def test_two_ray_batches_are_bitwise_equal(tracer):
    rays = [tracer.take(x) for x in random_rays(1000)]
    check_repeats(tracer, random_set(400), lambda leaves: tracer.trace(leaves, *rays))


def check_repeats(backend: Backend, scene: GaussianSet, draw) -> None:
    runs = []
    for _ in range(2):
        with threads_of(backend):
            leaves = backend.take(scene)
            drawn = draw(leaves)
            loss_of(drawn).backward()
        runs.append((drawn, gradients_of(leaves)))
    (one, gradients), (other, again) = runs
    for name in (*FIELDS, "hits"):
        assert torch.equal(getattr(one, name), getattr(other, name)), name
    if backend.name == "cpu":  # elsewhere sums over pixels may be taken in any order
        assert torch.equal(one.statistics.weights, other.statistics.weights)
        for name, gradient in gradients.items():
            assert torch.equal(gradient, again[name]), name


def test_facing_surfels_that_fill_the_image_agree_at_every_pixel(native):
    """Nothing is near a support's edge here: not one pixel is left out."""
    means = torch.stack([torch.zeros(8), torch.zeros(8), 2 + torch.arange(8.0)], 1)
    gaussians = facing_surfels(means, scale=30.0, opacity=0.3)
    keep = torch.ones(CAMERA.height, CAMERA.width) > 0
    one, other = (drawn_with(each, gaussians, image(), keep, ()) for each in (native, ORACLE))
    compare(one, other, keep)
