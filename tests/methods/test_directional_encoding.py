"""The encoding against SciPy's spherical harmonics, and against their mean over a von Mises-Fisher lobe."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from finite_differences import assert_gradients_are_differences
from scipy.special import sph_harm_y
from torch import Tensor
from torch.nn import functional

from envgs_bench.methods.lighting.directional_encoding import HARMONICS, SIZE, encoded


def directions(count: int) -> Tensor:
    return functional.normalize(torch.randn(count, 3, generator=torch.Generator().manual_seed(5)), dim=1)


def harmonics(towards: Tensor) -> Tensor:
    """The real parts, then the imaginary ones, of SciPy's Y_l^m, [..., SIZE]."""
    x, y, z = towards.double().numpy().T
    polar, azimuth = np.arccos(z.clip(-1, 1)), np.arctan2(y, x)
    values = np.stack([sph_harm_y(degree, order, polar, azimuth) for degree, order in HARMONICS], axis=-1)
    return torch.from_numpy(np.concatenate([values.real, values.imag], axis=-1))


def test_without_spread_it_is_the_harmonics() -> None:
    assert SIZE == 38  # of degrees 1, 2, 4 and 8
    towards = torch.cat([directions(200), torch.eye(3), -torch.eye(3)])
    found = encoded(towards, torch.zeros(len(towards), 1))
    torch.testing.assert_close(found.double(), harmonics(towards), atol=2e-5, rtol=0)


@pytest.mark.parametrize(("concentration", "error"), [(10.0, 0.015), (40.0, 4e-3), (300.0, 2.5e-4)])
def test_with_spread_it_is_their_mean_over_a_lobe(concentration: float, error: float) -> None:
    """Gauss-Legendre in the cosine to the axis, equal steps around it; what is tested approximates that."""
    (axis,) = directions(1)
    nodes, weights = np.polynomial.legendre.leggauss(400)
    cosine = torch.from_numpy(nodes)
    density = torch.from_numpy(weights) * (concentration * (cosine - 1)).exp()
    angle = torch.arange(64, dtype=torch.float64) * (2 * math.pi / 64)
    across = functional.normalize(torch.linalg.cross(axis, torch.tensor([0.0, 0.0, 1.0])), dim=0).double()
    upward = torch.linalg.cross(axis.double(), across)
    ring = angle.cos()[:, None] * across + angle.sin()[:, None] * upward
    around = cosine[:, None, None] * axis.double() + (1 - cosine.square()).sqrt()[:, None, None] * ring
    each = harmonics(around.reshape(-1, 3)).reshape(400, 64, SIZE).mean(1)
    mean = (each * density[:, None]).sum(0) / density.sum()

    found = encoded(axis[None], torch.tensor([[1 / concentration]]))[0].double()
    torch.testing.assert_close(found, mean, atol=error, rtol=0)


def test_gradients_are_those_of_finite_differences() -> None:
    towards = directions(3).double().requires_grad_()
    spread = torch.tensor([[0.01], [0.1], [0.5]], dtype=torch.float64, requires_grad=True)
    weights = torch.rand(3, SIZE, generator=torch.Generator().manual_seed(1)).double()

    def loss() -> Tensor:
        return (encoded(towards.float(), spread.float()).double() * weights).sum()

    assert_gradients_are_differences(loss, {"towards": towards, "spread": spread}, by=1e-2, rel=0.02)
