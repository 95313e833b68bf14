"""Unit vectors and their gradient, against torch's own normalization and finite differences."""

from __future__ import annotations

import torch
from torch.nn import functional

from envgs_bench.core.vectors import unit


def vectors() -> torch.Tensor:
    """[20, 3] of lengths from 1e-6 to 1e6."""
    generator = torch.Generator().manual_seed(0)
    lengths = torch.logspace(-6, 6, 20, dtype=torch.float64)[:, None]
    return lengths * functional.normalize(torch.randn(20, 3, generator=generator, dtype=torch.float64), dim=-1)


def test_units_and_their_gradient_are_torchs_own() -> None:
    ours, theirs = (vectors().requires_grad_() for _ in range(2))
    weights = torch.linspace(-1, 1, 60, dtype=torch.float64).reshape(20, 3)
    for vector, units in ((ours, unit(ours)), (theirs, functional.normalize(theirs, dim=-1))):
        torch.testing.assert_close(units.norm(dim=-1), torch.ones(20, dtype=torch.float64))
        (units * weights).sum().backward()
        assert vector.grad is not None
    torch.testing.assert_close(ours.grad, theirs.grad, rtol=1e-9, atol=1e-15)


def test_what_is_too_short_is_enlarged_alike_and_has_that_gradient() -> None:
    """No vector, and one of 5e-13: below 1e-12 the function is linear."""
    short = torch.tensor([[0.0, 0, 0], [3e-13, 0, 4e-13]], dtype=torch.float64, requires_grad=True)
    units = unit(short)
    torch.testing.assert_close(units, 1e12 * short)
    units[..., 2].sum().backward()
    torch.testing.assert_close(short.grad, torch.tensor([[0.0, 0, 1e12], [0, 0, 1e12]], dtype=torch.float64))


def test_gradient_is_the_derivative() -> None:
    some = vectors()[8:12].requires_grad_()  # of lengths from 0.1 to 10
    assert torch.autograd.gradcheck(unit, (some,))
