"""What was drawn and then changed in place, before the backward pass: its gradients are refused, as torch's own are."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from core_scenes import Backend, gradients_of, loss_of, plain_camera, random_rays, random_set, relative_error
from torch import Tensor

from envgs_bench.core import GaussianSet, Rendering

SET = ("means", "quaternions", "scales", "opacities", "sh", "extras")


def refused_or_right(
    backend: Backend, draw: Callable[..., Rendering], gaussians: GaussianSet, rays: dict[str, Tensor], changed: str
) -> None:
    """A native backend reads all of its inputs again; torch's formulas keep what they need of some."""

    def drawn() -> tuple[dict[str, Tensor], GaussianSet, Tensor]:
        leaves, own_rays = backend.take(gaussians), {name: backend.take(x) for name, x in rays.items()}
        return {**vars(leaves), **own_rays}, leaves, loss_of(draw(leaves, *own_rays.values()))

    _, unchanged, loss = drawn()
    loss.backward()
    inputs, leaves, loss = drawn()
    with torch.no_grad():
        inputs[changed].add_(0.01)
    if backend.name in ("cpu", "cuda"):
        with pytest.raises(RuntimeError, match="modified by an inplace operation"):
            loss.backward()
        return
    try:
        loss.backward()
    except RuntimeError as error:
        if "modified by an inplace operation" not in str(error):
            raise
        return
    gradients = gradients_of(leaves)
    for name, expected in gradients_of(unchanged).items():
        assert relative_error(gradients[name], expected) < 1e-9, name


@pytest.mark.parametrize("changed", SET)
@pytest.mark.parametrize("columns", [2, 3])
def test_images(rasterizer, columns, changed):
    camera = rasterizer.take(plain_camera())
    refused_or_right(
        rasterizer, lambda leaves: rasterizer.rasterize(leaves, camera), random_set(20, columns=columns), {}, changed
    )


@pytest.mark.parametrize("changed", [*SET, "origins", "directions"])
def test_rays(tracer, changed):
    rays = dict(zip(("origins", "directions"), random_rays(50), strict=True))
    refused_or_right(tracer, tracer.trace, random_set(20), rays, changed)
