"""What a backend draws beside what the float64 oracle does: scenes, drawings of both, and their comparison."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import cache

import torch
from core_scenes import (
    FIELDS,
    ORACLE,
    Backend,
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
from torch import Tensor
from torch_threads import torch_threads

from envgs_bench.core import GaussianSet, Rendering

Draw = Callable[[Backend, GaussianSet, list[Tensor]], Rendering]
Drawn = tuple[Rendering, dict[str, Tensor]]

TOLERANCE = 1e-3
CAMERA = tilted_camera(53, 41)
BACKGROUND = torch.tensor([0.7, 0.2, 0.4])

SINGLE = Backend("torch", torch.float32, "cpu")  # the oracle itself, in the precision of the native backends


def with_sites(gaussians: GaussianSet, seed: int) -> GaussianSet:
    """The set with the colors of sites, whose cells end softly and sharply."""
    generator, count = torch.Generator().manual_seed(seed), len(gaussians)
    colors = 1.4 * torch.rand(count, 8, 3, generator=generator) - 0.4
    vectors = torch.randn(count, 8, 3, generator=generator) * torch.linspace(0, 6, count)[:, None, None]
    return replace(gaussians, sh=torch.cat([colors, vectors], dim=-1))


SCENES = {
    "few": random_set(12, seed=1),
    "many": random_set(400, seed=2),
    "degree-0": random_set(150, degree=0, extras=0, seed=3),
    "degree-1": random_set(150, degree=1, extras=3, seed=4),
    "degree-3": random_set(150, degree=3, extras=8, seed=5),
    "sites": with_sites(random_set(150, extras=2, seed=10), seed=10),
    "opaque": replace(random_set(300, seed=6), opacities=torch.linspace(0.9, 1.0, 300)),
    "faint": replace(random_set(300, seed=7), opacities=torch.linspace(0.0, 0.05, 300)),
    "tiny": replace(random_set(300, seed=8), scales=torch.full((300, 2), 0.01)),
    "elongated": replace(random_set(200, seed=9), scales=torch.tensor([[0.5, 0.01]]).expand(200, 2)),
}


def to_gaussians_3d(surfels: GaussianSet) -> GaussianSet:
    third = surfels.scales.mean(dim=1, keepdim=True) * torch.linspace(0.1, 1.5, len(surfels))[:, None]
    return replace(surfels, scales=torch.cat([surfels.scales, third], dim=1))


def threads_of(backend: Backend) -> AbstractContextManager[None]:
    """Two for the CPU's kernels, whose threads add up each other's gradients; `make test` gives a process one."""
    return torch_threads(2) if backend.name == "cpu" else nullcontext()


def drawn_with(backend: Backend, gaussians: GaussianSet, draw: Draw, keep: Tensor, rays: tuple[Tensor, ...]) -> Drawn:
    """What a backend draws, and the gradients of a loss over the kept pixels or rays."""
    leaves, own_rays = backend.take(gaussians), [backend.take(x) for x in rays]
    with threads_of(backend):
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


def compare_image_color(backend: Backend, scene: str, as_gaussians_3d: bool, low_pass: bool = True) -> None:
    """Hold what `rasterize_color` draws beside the oracle."""
    gaussians, keep, (expected, _) = oracle_image(scene, as_gaussians_3d, low_pass)
    inputs = [backend.take(x) for x in (gaussians, CAMERA)]
    drawn = backend.rasterize_color(*inputs, low_pass=low_pass, background=BACKGROUND)
    for own, reference in zip(drawn, (expected.color, expected.alpha), strict=True):
        assert relative_error(own[keep.to(own.device)], reference[keep]) < TOLERANCE / 10


def compare_ray_color(backend: Backend, scene: str, sh_direction: str) -> None:
    """Hold what `trace_color` draws beside the oracle, with room for coefficients in half precision."""
    gaussians, rays, (expected, _) = oracle_ray_batch(scene, sh_direction)
    inputs = [backend.take(x) for x in (gaussians, *rays)]
    color, alpha = backend.trace_color(*inputs, t_min=0.5, background=BACKGROUND, sh_direction=sh_direction)
    difference = (color.double().cpu() - expected.color.detach()).abs()
    assert difference.max() < 5e-4
    assert difference.mean() < 5e-5
    assert relative_error(alpha, expected.alpha) < TOLERANCE / 10


def image(low_pass: bool = True) -> Draw:
    return lambda backend, leaves, rays: backend.rasterize(
        leaves, backend.take(CAMERA), low_pass=low_pass, background=BACKGROUND
    )


def ray_batch(sh_direction: str = "center") -> Draw:
    return lambda backend, leaves, rays: backend.trace(
        leaves, *rays, t_min=0.5, background=BACKGROUND, sh_direction=sh_direction
    )


@cache
def oracle_image(scene: str, as_gaussians_3d: bool, low_pass: bool) -> tuple[GaussianSet, Tensor, Drawn]:
    """A scene, the pixels that can be compared, and the oracle's drawing: the same for every backend."""
    gaussians = to_gaussians_3d(SCENES[scene]) if as_gaussians_3d else SCENES[scene]
    keep = steady(gaussians, rasterized(gaussians, CAMERA, low_pass=low_pass))
    return gaussians, keep, drawn_with(ORACLE, gaussians, image(low_pass), keep, ())


@cache
def oracle_ray_batch(scene: str, sh_direction: str = "center") -> tuple[GaussianSet, tuple[Tensor, ...], Drawn]:
    """A scene, rays that can be compared (and no others, so that statistics can be too), and the oracle's drawing."""
    gaussians, (origins, directions) = SCENES[scene], random_rays(1000)
    keep = steady(gaussians, traced(gaussians, origins, directions, t_min=0.5))
    assert keep.double().mean() > 0.75
    rays = origins[keep], directions[keep]
    return gaussians, rays, drawn_with(ORACLE, gaussians, ray_batch(sh_direction), keep[keep], rays)
