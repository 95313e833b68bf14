"""The map by longitude and latitude: its levels, where directions lie, no seam sideways, and its gradients."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates
from torch import Tensor
from torch.nn import functional

from envgs_bench.methods.lighting.latlong import all_levels, looked_up, shape_of

LEVELS = 4


def texels(channels: int = 2) -> Tensor:
    return torch.rand(*shape_of(LEVELS), channels, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def directions(count: int = 200) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=1)


def reference(level: Tensor, along: Tensor) -> Tensor:
    """SciPy's bilinear lookup of one level, wrapped sideways and held at the poles."""
    rows, columns, _ = level.shape
    around = torch.atan2(along[:, 1], along[:, 0]) / (2 * math.pi) + 0.5
    down = along[:, 2].acos() / math.pi
    x, y = (around * columns - 0.5).numpy(), (down * rows - 0.5).clamp(0, rows - 1).numpy()
    values = [
        map_coordinates(np.concatenate([channel] * 3, axis=1), [y, x + columns], order=1)
        for channel in level.permute(2, 0, 1).numpy()
    ]
    return torch.from_numpy(np.stack(values, axis=1))


@pytest.mark.parametrize("level", range(LEVELS + 1))
def test_a_level_is_looked_up_as_scipy_does(level: int) -> None:
    halved = texels()
    for _ in range(level):
        halved = halved.reshape(halved.shape[0] // 2, 2, halved.shape[1] // 2, 2, -1).mean((1, 3))
    along = directions()
    roughness = torch.full((len(along),), level / LEVELS, dtype=torch.float64)
    found = looked_up(all_levels(texels()), along, roughness, LEVELS)
    torch.testing.assert_close(found, reference(halved, along), atol=1e-9, rtol=0)


def test_between_two_levels_both_count() -> None:
    flat, along = all_levels(texels()), directions()
    one, two, between = (looked_up(flat, along, torch.full((200,), r).double(), LEVELS) for r in (0.25, 0.5, 0.3125))
    torch.testing.assert_close(between, 0.75 * one + 0.25 * two)


def test_gradients_are_finite_differences_and_finite_at_the_poles() -> None:
    flat, along = all_levels(texels()).requires_grad_(), directions(20).requires_grad_()
    roughness = torch.full((20,), 0.4, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda *x: looked_up(*x, LEVELS), (flat, along, roughness))
    poles = torch.tensor([[0.0, 0, 1], [0, 0, -1], [0, 0, 0]]).double().requires_grad_()
    looked_up(flat, poles, roughness[:3], LEVELS).sum().backward()
    assert poles.grad is not None
    assert poles.grad.isfinite().all()


@pytest.mark.parametrize("spoiled", ["directions", "roughness"])
def test_what_is_not_a_number_is_looked_up_without_an_error(spoiled: str) -> None:
    """A step replayed from a graph that lacked room shows NaN: an index made of it would end a GPU's run."""
    along, roughness = directions(3), torch.full((3,), 0.4, dtype=torch.float64)
    (along if spoiled == "directions" else roughness)[1] = torch.nan
    found = looked_up(all_levels(texels()), along, roughness, LEVELS)
    assert found.isnan().all(dim=1).tolist() == [False, True, False]
