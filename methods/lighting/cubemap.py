"""A cube map and its differentiable bilinear lookup, without seams between faces; plain torch on every backend.

Face order and orientation are OpenGL's: +x, −x, +y, −y, +z, −z; on each, column and row grow along the signed axes of
the table below, and texel centers lie at half-integers of the face's size.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .texels import texel_below

# face -> (axis of the face, its sign), (axis of columns, sign), (axis of rows, sign)
FACES = (
    ((0, 1), (2, -1), (1, -1)),
    ((0, -1), (2, 1), (1, -1)),
    ((1, 1), (0, 1), (2, 1)),
    ((1, -1), (0, 1), (2, -1)),
    ((2, 1), (0, 1), (1, -1)),
    ((2, -1), (0, -1), (1, -1)),
)
AXES, SIGNS = torch.tensor(FACES)[:, 1:].unbind(-1)  # [6, 2] each, of columns and rows


@dataclass(frozen=True)
class CubemapLayout:
    """Where the texels of a map of S texels an edge lie; `layout_of(S)` makes it, on one device."""

    # Flat numbers of a face's texels and of the ring of their neighbors on other faces. Beyond a face's four corners
    # there is none; the number there is 6·S² plus that of the cube's corner.
    around: Tensor  # [6, S + 2, S + 2]
    corners: Tensor  # [8, 3] flat numbers of the three texels that meet at each corner of the cube
    axes: Tensor  # AXES and SIGNS
    signs: Tensor


def layout_of(size: int, device: torch.device | str = "cpu") -> CubemapLayout:
    tensors = (_texels_around(size), _corner_texels(size), AXES, SIGNS)
    return CubemapLayout(*(tensor.to(device) for tensor in tensors))


def texel_directions(size: int) -> Tensor:
    """Directions [6, size, size, 3] through the texel centers; the largest component is ±1."""
    center = (2 * torch.arange(size) + 1) / size - 1
    return _face_points(center, center)


def sample_cubemap(texels: Tensor, directions: Tensor, layout: CubemapLayout) -> Tensor:
    """Bilinear lookup, differentiable in texels and directions.

    Args:
        texels: [6, S, S, C].
        directions: [R, 3], of any length; at length 0 the lookup has a value, but no meaning. NaN where one is NaN.
        layout: that of maps with S texels an edge.

    Returns:
        [R, C], continuous over the whole sphere: across an edge the four texels around a point come from both faces,
        and at the cube's corners, where three texels meet, the missing fourth is their mean.
    """
    size, channels = texels.shape[1], texels.shape[-1]
    flat = texels.reshape(-1, channels)
    flat = torch.cat([flat, flat[layout.corners].mean(1)])

    index, fx, fy = _four_texels(directions, layout, size)
    around = flat.index_select(0, index.reshape(-1)).reshape(4, -1, channels)
    top = torch.lerp(around[0], around[1], fx)
    bottom = torch.lerp(around[2], around[3], fx)
    return torch.lerp(top, bottom, fy)


def bilinear_texels(directions: Tensor, size: int) -> tuple[Tensor, Tensor, Tensor]:
    """What `sample_cubemap` reads of a map with `size` texels an edge, as a sparse matrix.

    Returns:
        The number of the direction, the flat number of a texel, and that texel's share in the lookup, [K] each; a
        direction's shares sum to 1, and a texel may occur more than once.
    """
    layout = layout_of(size)
    index, fx, fy = _four_texels(directions, layout, size)
    fx, fy = fx[:, 0], fy[:, 0]
    shares = torch.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy])
    rows = torch.arange(len(directions)).expand_as(index)
    beyond = index >= 6 * size * size
    corners = layout.corners[index[beyond] - 6 * size * size]  # [B, 3]
    return (
        torch.cat([rows[~beyond], rows[beyond].repeat_interleave(3)]),
        torch.cat([index[~beyond], corners.reshape(-1)]),
        torch.cat([shares[~beyond], (shares[beyond] / 3).repeat_interleave(3)]),
    )


def resized_cubemap(texels: Tensor, layout: CubemapLayout, size: int) -> Tensor:
    """The map [6, S, S, C] looked up at the texel centers of one with `size` texels an edge: [6, size, size, C]."""
    directions = texel_directions(size).to(texels)
    return sample_cubemap(texels, directions.reshape(-1, 3), layout).reshape(6, size, size, -1)


def _four_texels(directions: Tensor, layout: CubemapLayout, size: int) -> tuple[Tensor, Tensor, Tensor]:
    """Numbers [4, R] of the texels around each direction, corners of the cube behind them, and the place between."""
    face, column, row = _face_coordinates(directions, layout.axes, layout.signs)
    x = (column + 1) * (size / 2) + 0.5  # in the padded face, whose texel i has its center at i
    y = (row + 1) * (size / 2) + 0.5
    x0, y0 = (texel_below(place).clamp(0, size) for place in (x, y))
    corner = (face * (size + 2) + y0.long()) * (size + 2) + x0.long()
    index = torch.stack([corner, corner + 1, corner + size + 2, corner + size + 3])
    return layout.around.reshape(-1)[index], (x - x0)[:, None], (y - y0)[:, None]


def _texels_around(size: int) -> Tensor:
    position = (2 * torch.arange(size + 2, dtype=torch.float64) - 1) / size - 1
    inside = position.clamp(-1 + 1 / size, 1 - 1 / size)
    own = torch.arange(6 * size * size).reshape(6, size, size)
    index = torch.zeros(6, size + 2, size + 2, dtype=torch.long)
    index[:, 1:-1, 1:-1] = own
    # Just beyond an edge, a point of the face's plane belongs to the neighboring face, in its outermost texel.
    beyond = position.clamp(-1 - 1e-3 / size, 1 + 1e-3 / size)
    for part in ((slice(None), [0, -1]), ([0, -1], slice(None))):
        columns = beyond if part[0] == slice(None) else inside
        rows = inside if part[0] == slice(None) else beyond
        points = _face_points(columns, rows).reshape(-1, 3)
        face, column, row = _face_coordinates(points, AXES, SIGNS)
        texel = (face * size + _texel(row, size)) * size + _texel(column, size)
        texel = texel.reshape(6, size + 2, size + 2)
        index[:, part[0], part[1]] = texel[:, part[0], part[1]]
    ends = torch.tensor([-1.0, 1.0])
    corners = _corner_number(_face_points(ends, ends))
    index[:, :: size + 1, :: size + 1] = 6 * size * size + corners
    return index


def _face_points(columns: Tensor, rows: Tensor) -> Tensor:
    """Points [6, len(rows), len(columns), 3] of the faces at coordinates in [−1, 1]."""
    points = torch.zeros(6, len(rows), len(columns), 3, dtype=columns.dtype)
    for face, ((axis, sign), (across, across_sign), (down, down_sign)) in enumerate(FACES):
        points[face, ..., axis] = sign
        points[face, ..., across] = across_sign * columns[None, :]
        points[face, ..., down] = down_sign * rows[:, None]
    return points


def _face_coordinates(directions: Tensor, axes: Tensor, signs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Face [R], and column and row on it, [R] in [−1, 1], differentiable."""
    axis = directions.detach().abs().argmax(dim=1)
    major = directions.gather(1, axis[:, None])[:, 0]
    face = 2 * axis + (major.detach() < 0)
    scaled = directions.gather(1, axes[face]) * signs[face] / major.abs().clamp_min(1e-30)[:, None]
    return face, scaled[:, 0], scaled[:, 1]


def _texel(coordinate: Tensor, size: int) -> Tensor:
    return ((coordinate + 1) * (size / 2)).floor().long().clamp(0, size - 1)


def _corner_number(directions: Tensor) -> Tensor:
    """0 to 7 for the octant a direction points into."""
    return (directions > 0).long() @ torch.tensor([1, 2, 4])


def _corner_texels(size: int) -> Tensor:
    """[8, 3] flat numbers of the three texels that meet at each corner of the cube."""
    numbers = torch.arange(6 * size * size).reshape(6, size, size)[:, :: max(size - 1, 1), :: max(size - 1, 1)]
    corner = _corner_number(texel_directions(size)[:, :: max(size - 1, 1), :: max(size - 1, 1)])
    return torch.stack([numbers[corner == number] for number in range(8)])
