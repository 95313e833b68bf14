"""What pictures lose with each primitive, as the backward pass finds it, against pictures drawn without it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from backends import EMULATED, usable
from core_scenes import Backend, plain_camera, random_rays, random_set
from torch import Tensor

from envgs_bench.core import GaussianSet, Rendering, removal_gradients

RAYS = random_rays(400)
SEEN = 5  # primitives at least that change something, or nothing is shown
Draw = Callable[[Backend, GaussianSet], Rendering]


@pytest.fixture(params=["cpu", "cuda", "torch", EMULATED])
def backend(request: pytest.FixtureRequest) -> Backend:
    return usable(request)


def image(backend: Backend, gaussians: GaussianSet) -> Rendering:
    return backend.rasterize(gaussians, backend.take(plain_camera()), background=torch.full((3,), 0.5))


def rays(backend: Backend, gaussians: GaussianSet) -> Rendering:
    return backend.trace(gaussians, *(x.to(backend.device, backend.dtype) for x in RAYS))


def outputs(drawing: Rendering) -> Tensor:
    """All that is affine in a hit's alpha, [P, 7 + E]."""
    values = (drawing.color, drawing.alpha[..., None], drawing.normal, drawing.extras)
    return torch.cat([x.flatten(0, -2) for x in values], dim=1)


def opaque_in_part(gaussians: GaussianSet) -> GaussianSet:
    """Every third is opaque, so that its alpha is clamped in its middle."""
    gaussians.opacities[::3] = 1.0
    return gaussians


@pytest.mark.parametrize(
    ("draw", "gaussians"),
    [(image, random_set(12)), (image, random_set(12, columns=3)), (rays, random_set(12))],
    ids=["surfels", "gaussians_3d", "rays"],
)
def test_opacities_gradients_are_squared_changes_without_the_primitive(
    backend: Backend, draw: Draw, gaussians: GaussianSet
) -> None:
    taken = backend.take(opaque_in_part(gaussians))
    with removal_gradients():
        whole = outputs(draw(backend, taken))
    counts = torch.randn(whole.shape, generator=torch.Generator().manual_seed(3)).to(whole)
    (found,) = torch.autograd.grad((counts * whole).sum(), taken.opacities)
    expected = []
    for row in range(len(taken)):
        others = torch.arange(len(taken), device=backend.device) != row
        with torch.no_grad():
            change = outputs(draw(backend, taken.map(lambda values, rows=others: values[rows]))) - whole
        expected.append((counts * change).sum(dim=1).square().sum())
    assert sum(value > 0.1 for value in expected) >= SEEN
    torch.testing.assert_close(found, torch.stack(expected), rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("draw", [image, rays])
def test_all_other_gradients_stay(backend: Backend, draw: Draw) -> None:
    def gradients() -> list[Tensor]:
        taken = backend.take(random_set(12))
        drawing = draw(backend, taken)
        fields = (taken.means, taken.quaternions, taken.scales, taken.sh, taken.extras)
        return list(torch.autograd.grad(outputs(drawing).square().sum() + drawing.depth.sum(), fields))

    expected = gradients()
    with removal_gradients():
        torch.testing.assert_close(gradients(), expected)
