"""Places: cubes of a scene, in which errors are added up from wherever they are seen.

What one view shows of a pane is noise and a few pixels. What all views show of it tells whether it is drawn better.
"""

from __future__ import annotations

from itertools import product

import torch
from torch import Tensor

SHIFTS = tuple(product((0.0, 0.5), repeat=3))  # of eight grids, in cubes: what one of them cuts in two, others do not
INDICES = 2**20  # cubes along an axis, at most: three indices make a number


def gained_by_place(points: Tensor, before: Tensor, after: Tensor, size: float) -> Tensor:
    """How much smaller the errors around each point became, dB [P]: 10·log₁₀(Σ before / Σ after) over its place.

    A point's place are the eight cubes that it lies in, one of each grid; the sums are over all points of these.

    Args:
        points: [P, 3], world frame.
        before, after: their squared errors [P], not negative.
        size: edge of a cube, world units.
    """
    sums = torch.zeros(2, len(points), dtype=torch.float64, device=points.device)
    errors = torch.stack([before, after]).double()
    for shift in SHIFTS:
        cubes = (points.double() / size + torch.tensor(shift, device=points.device)).floor()
        indices = cubes.clamp(-INDICES // 2, INDICES // 2 - 1).long() + INDICES // 2
        numbers = (indices[:, 0] * INDICES + indices[:, 1]) * INDICES + indices[:, 2]
        _, cube = torch.unique(numbers, return_inverse=True)
        sums += torch.zeros_like(sums).index_add_(1, cube, errors)[:, cube]
    tiny = torch.finfo(torch.float32).tiny
    return (10 * (sums[0].clamp_min(tiny) / sums[1].clamp_min(tiny)).log10()).float()
