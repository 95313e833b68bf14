"""The factorized field against the dense volume that it stands for, interpolated by torch."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.methods.lighting.tensor_field import field_components

RANK, SIZE = 4, 6


def factors() -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(8)
    return (
        torch.randn(3, SIZE, SIZE, RANK, generator=generator),
        torch.randn(3, SIZE, RANK, generator=generator),
    )


def volumes(planes: Tensor, lines: Tensor) -> Tensor:
    """[3·R, z, y, x]: a mode's pictures have rows y, z, z and columns x, x, y."""
    return torch.cat(
        [
            torch.einsum("yxr,zr->rzyx", planes[0], lines[0]),
            torch.einsum("zxr,yr->rzyx", planes[1], lines[1]),
            torch.einsum("zyr,xr->rzyx", planes[2], lines[2]),
        ]
    )


@pytest.mark.parametrize("reach", [1.0, 1.3])
def test_it_is_the_dense_volume_interpolated(reach: float) -> None:
    """And 0 around the box, from a cell's width (here 0.4) on."""
    planes, lines = factors()
    places = reach * (2 * torch.rand(300, 3, generator=torch.Generator().manual_seed(2)) - 1)
    grid = places[None, :, None, None]
    expected = functional.grid_sample(volumes(planes, lines)[None], grid, align_corners=True)[0, :, :, 0, 0].T
    torch.testing.assert_close(field_components(planes, lines, places), expected, atol=1e-5, rtol=1e-5)
    assert not field_components(planes, lines, 1.41 * places.sign()).any()


def test_the_outermost_samples_lie_on_the_boxs_faces() -> None:
    planes, lines = factors()
    corner = field_components(planes, lines, torch.tensor([[-1.0, 1.0, 1.0]]))
    expected = torch.cat([planes[0, -1, 0] * lines[0, -1], planes[1, -1, 0] * lines[1, -1]])
    torch.testing.assert_close(corner[0, : 2 * RANK], expected)


def test_gradients_are_those_of_finite_differences() -> None:
    inputs = [values.double().requires_grad_() for values in factors()]
    places = 2 * torch.rand(5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(4)) - 1
    torch.autograd.gradcheck(lambda planes, lines: field_components(planes, lines, places), inputs)
