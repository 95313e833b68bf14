"""A map of the surroundings by longitude and latitude, with levels of half the size each, looked up by roughness.

Level l of a map of L levels has 2^(L − l) rows and twice as many columns; the last has one row. Rows go from +z to −z,
columns around z from −x by −y; a map has no seam sideways, and ends at the poles.
"""

from __future__ import annotations

import math
from functools import cache

import torch
from torch import Tensor
from torch.nn import functional

from .texels import texel_below

AT_POLE = 1e-6  # of x² + y², below which a direction has no longitude to learn from


def shape_of(levels: int) -> tuple[int, int]:
    """Rows and columns of the first level."""
    return 2**levels, 2 ** (levels + 1)


def all_levels(texels: Tensor) -> Tensor:
    """The texels of all levels, one after the other, [T, C], of those of the first [H, 2 H, C]: means of four each."""
    level = texels.permute(2, 0, 1)[None]
    found = [level]
    while level.shape[2] > 1:
        level = functional.avg_pool2d(level, 2)
        found.append(level)
    return torch.cat([each[0].flatten(1).T for each in found])


def looked_up(texels: Tensor, directions: Tensor, roughness: Tensor, levels: int) -> Tensor:
    """The map's values [R, C], trilinear, NaN where given NaN; differentiable in texels, directions and roughness.

    Args:
        texels: [T, C] of `all_levels`, whose first level has 2^levels rows.
        directions: [R, 3], unit; a shorter one has a value, but no meaning.
        roughness: [R] in [0, 1]: 0 is the first level, 1 the last.
    """
    x, y, z = directions.unbind(-1)
    polar = x.square() + y.square() < AT_POLE
    around = torch.atan2(torch.where(polar, 0.0, y), torch.where(polar, 1.0, x)) / (2 * math.pi) + 0.5
    down = z.clamp(-1 + AT_POLE, 1 - AT_POLE).acos() / math.pi
    level = roughness.clamp(0, 1) * levels
    finer = texel_below(level).clamp(0, levels - 1)
    own, coarser = (_bilinear(texels, around, down, (finer + step).long(), levels) for step in (0, 1))
    return torch.lerp(own, coarser, (level - finer)[:, None])


def _bilinear(texels: Tensor, around: Tensor, down: Tensor, level: Tensor, levels: int) -> Tensor:
    """The value of one level at places in [0, 1], [R, C]."""
    rows = 2 ** (levels - level)
    x, y = around * (2 * rows) - 0.5, down * rows - 0.5
    left, top = texel_below(x), texel_below(y)
    first = _first_texels(levels, texels.device)[level]
    corners = []
    for row in (top.long(), top.long() + 1):
        row = torch.minimum(row.clamp_min(0), rows - 1)
        for column in (left.long(), left.long() + 1):
            corners.append(first + row * (2 * rows) + column % (2 * rows))
    values = texels.index_select(0, torch.cat(corners)).reshape(4, len(level), -1)
    beside, below = (x - left)[:, None], (y - top)[:, None]
    return torch.lerp(torch.lerp(values[0], values[1], beside), torch.lerp(values[2], values[3], beside), below)


@cache
def _first_texels(levels: int, device: torch.device) -> Tensor:
    """The number of each level's first texel, [levels + 1]."""
    sizes = [2 ** (2 * (levels - level) + 1) for level in range(levels + 1)]
    return torch.tensor([0, *sizes[:-1]], device=device).cumsum(0)
