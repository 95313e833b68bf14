"""The backends against the float64 oracle and against each other: every field, every gradient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import pytest
import torch
from conftest import EMULATED, usable
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
from scipy.spatial.transform import Rotation
from torch import Tensor

from envgs_bench.core import GaussianSet, Rendering

TOLERANCE = 1e-3
CAMERA = tilted_camera(53, 41)
BACKGROUND = torch.tensor([0.7, 0.2, 0.4])

SINGLE = Backend("torch", torch.float32, "cpu")  # the oracle itself, in the precision of the native backends


SCENES = {
    "few": random_set(12, seed=1),
    "many": random_set(400, seed=2),
    "degree-0": random_set(150, degree=0, extras=0, seed=3),
    "degree-1": random_set(150, degree=1, extras=3, seed=4),
    "degree-3": random_set(150, degree=3, extras=8, seed=5),
    "opaque": replace(random_set(300, seed=6), opacities=torch.linspace(0.9, 1.0, 300)),
    "faint": replace(random_set(300, seed=7), opacities=torch.linspace(0.0, 0.05, 300)),
    "tiny": replace(random_set(300, seed=8), scales=torch.full((300, 2), 0.01)),
    "needles": replace(random_set(200, seed=9), scales=torch.tensor([[0.5, 0.01]]).expand(200, 2)),
}


def volumes(surfels: GaussianSet) -> GaussianSet:
    third = surfels.scales.mean(dim=1, keepdim=True) * torch.linspace(0.1, 1.5, len(surfels))[:, None]
    return replace(surfels, scales=torch.cat([surfels.scales, third], dim=1))


@pytest.fixture(params=["cpu", "cuda", "torch", EMULATED])
def single(request: pytest.FixtureRequest) -> Backend:
    """The backends in float32, the oracle's own float32 among them."""
    return SINGLE if request.param == "torch" else usable(request)


Draw = Callable[[Backend, GaussianSet, list[Tensor]], Rendering]
Drawn = tuple[Rendering, dict[str, Tensor]]


def drawn_with(backend: Backend, gaussians: GaussianSet, draw: Draw, keep: Tensor, rays: tuple[Tensor, ...]) -> Drawn:
    """What a backend draws, and the gradients of a loss over the kept pixels or rays."""
    leaves, own_rays = backend.take(gaussians), [backend.take(x) for x in rays]
    drawn = draw(backend, leaves, own_rays)
    loss_of(drawn, keep).backward()
    return drawn, gradients_of(leaves, **dict(zip(("origins", "directions"), own_rays, strict=False)))


def compare(one: Drawn, other: Drawn, keep: Tensor) -> None:
    """Hold every field, statistic and gradient of the kept pixels or rays together."""
    assert keep.double().mean() > 0.75, "too little of the scene is comparable to say anything"
    (drawn, gradients), (expected, expected_gradients) = one, other
    where = keep.to(drawn.alpha.device)
    assert torch.equal(drawn.hits[where].cpu(), expected.hits[keep])
    for name in FIELDS:
        assert relative_error(getattr(drawn, name)[where], getattr(expected, name)[keep]) < TOLERANCE / 10, name
    for name, gradient in gradients.items():
        assert gradient.isfinite().all(), name
        assert relative_error(gradient, expected_gradients[name]) < TOLERANCE, name
    position, reference = drawn.statistics.position_gradients, expected.statistics.position_gradients
    assert position is not None
    assert reference is not None
    assert relative_error(position, reference) < TOLERANCE
    if keep.all():
        assert relative_error(drawn.statistics.weights, expected.statistics.weights) < TOLERANCE


def image(low_pass: bool = True) -> Draw:
    return lambda backend, leaves, rays: backend.rasterize(
        leaves, backend.take(CAMERA), low_pass=low_pass, background=BACKGROUND
    )


def bundle(backend: Backend, leaves: GaussianSet, rays: list[Tensor]) -> Rendering:
    return backend.trace(leaves, *rays, t_min=0.5, background=BACKGROUND)


@cache
def oracles_image(scene: str, as_volumes: bool, low_pass: bool) -> tuple[GaussianSet, Tensor, Drawn]:
    """A scene, the pixels that can be compared, and the oracle's drawing: the same for every backend."""
    gaussians = volumes(SCENES[scene]) if as_volumes else SCENES[scene]
    keep = steady(gaussians, rasterized(gaussians, CAMERA, low_pass=low_pass))
    return gaussians, keep, drawn_with(ORACLE, gaussians, image(low_pass), keep, ())


@cache
def oracles_bundle(scene: str) -> tuple[GaussianSet, tuple[Tensor, ...], Drawn]:
    """A scene, rays that can be compared (and no others, so that statistics can be too), and the oracle's drawing."""
    gaussians, (origins, directions) = SCENES[scene], random_rays(1000)
    keep = steady(gaussians, traced(gaussians, origins, directions, t_min=0.5))
    assert keep.double().mean() > 0.75
    rays = origins[keep], directions[keep]
    return gaussians, rays, drawn_with(ORACLE, gaussians, bundle, keep[keep], rays)


@pytest.mark.parametrize("low_pass", [True, False], ids=["low-pass", "exact"])
@pytest.mark.parametrize("as_volumes", [False, True], ids=["surfels", "volumes"])
@pytest.mark.parametrize("scene", list(SCENES))
def test_images(single, scene, as_volumes, low_pass):
    gaussians, keep, expected = oracles_image(scene, as_volumes, low_pass)
    compare(drawn_with(single, gaussians, image(low_pass), keep, ()), expected, keep)


@pytest.mark.parametrize("scene", list(SCENES))
def test_bundles_of_rays(single, scene):
    gaussians, rays, expected = oracles_bundle(scene)
    keep = torch.ones(len(rays[0])) > 0
    compare(drawn_with(single, gaussians, bundle, keep, rays), expected, keep)


@pytest.mark.parametrize("scene", list(SCENES))
def test_embree_finds_the_same_hits(scene):
    """In float64, hit for hit, without leaving any ray out."""
    gaussians, rays, keep = SCENES[scene], random_rays(1000), torch.ones(1000) > 0
    one, other = (drawn_with(each, gaussians, bundle, keep, rays) for each in (Backend.named("embree"), ORACLE))
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
    """Tilted surfels, each alone in a slab of the camera's depth, so that hits and centres sort alike."""
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


def test_two_bundles_are_bitwise_equal(tracer):
    rays = [tracer.take(x) for x in random_rays(1000)]
    check_repeats(tracer, random_set(400), lambda leaves: tracer.trace(leaves, *rays))


def check_repeats(backend: Backend, scene: GaussianSet, draw) -> None:
    runs = []
    for _ in range(2):
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
