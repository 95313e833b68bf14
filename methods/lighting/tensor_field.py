"""A field over a box as sums of products of a matrix and a vector (TensoRF, Chen et al., ECCV 2022, Eq. 4).

Each component is a picture over two axes times a profile along the third, both interpolated linearly, so that their
product is what trilinear interpolation makes of the whole volume, which nobody has to hold.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

MODES = ((1, 0, 2), (2, 0, 1), (2, 1, 0))  # the axes of a picture's rows and columns, and the profile's


def field_components(planes: Tensor, lines: Tensor, places: Tensor) -> Tensor:
    """The components [N, 3·R] at `places`, those of the first mode first. Differentiable in planes and lines.

    Args:
        planes: [3, S, S, R] pictures, a mode each: rows, columns, components. A place reads whole rows of memory, in a
            quarter of the time that `grid_sample` takes for pictures that lie one behind the other.
        lines: [3, S, R] profiles.
        places: [N, 3] in the box's own frame, which is [−1, 1]³: the outermost samples lie on its faces. Outside, the
            field falls to 0 within the width of a cell.
    """
    size, count = lines.shape[1:]
    samples, shares = _neighbors(places.detach(), size)
    of_planes, of_lines = [], []  # of each mode: the numbers of the samples around a place, and their shares
    for mode, (row, column, along) in enumerate(MODES):
        corners = (mode * size + samples[:, row, :, None]) * size + samples[:, column, None]
        of_planes.append((corners.flatten(1), (shares[:, row, :, None] * shares[:, column, None]).flatten(1)))
        of_lines.append((mode * size + samples[:, along], shares[:, along]))
    products = _interpolated(planes, of_planes) * _interpolated(lines, of_lines)
    return products.reshape(3, -1, count).transpose(0, 1).flatten(1)


def _neighbors(places: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """The samples below and above a place along each axis, and their shares, which are 0 beyond the box; [N, 3, 2]."""
    at = (places + 1) * ((size - 1) / 2)
    below = at.floor()
    samples = torch.stack([below, below + 1], dim=-1)
    shares = torch.stack([below + 1 - at, at - below], dim=-1)
    shares = torch.where((samples >= 0) & (samples < size), shares, 0.0)
    return samples.clamp(0, size - 1).long(), shares


def _interpolated(values: Tensor, parts: list[tuple[Tensor, Tensor]]) -> Tensor:
    """Σ share · sample of the rows [R] of `values`, for one mode's places after another's."""
    samples, shares = (torch.cat(part) for part in zip(*parts, strict=True))
    return functional.embedding_bag(
        samples, values.flatten(0, -2), per_sample_weights=shares.to(values.dtype), mode="sum"
    )
