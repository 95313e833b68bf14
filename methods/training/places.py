"""Places: cubes of a scene, in which numbers are added up from wherever they are seen.

What one view shows of a pane is noise and a few pixels. What all views show of it tells more.
"""

from __future__ import annotations

from itertools import product

import torch
from torch import Tensor

SHIFTS = tuple(product((0.0, 0.5), repeat=3))  # of eight grids, in cubes: what one of them cuts in two, others do not
INDICES = 2**20  # cubes along an axis, at most: three indices make a number


def sums_by_place(points: Tensor, values: Tensor, size: float) -> Tensor:
    """The values around each point, added up over its place, [K, P] float64.

    A point's place are the eight cubes that it lies in, one of each grid; a value counts once for each that it shares.

    Args:
        points: [P, 3], world frame.
        values: [K, P], K numbers of each point.
        size: edge of a cube, world units.
    """
    sums = torch.zeros(values.shape, dtype=torch.float64, device=points.device)
    for shift in SHIFTS:
        cubes = (points.double() / size + torch.tensor(shift, device=points.device)).floor()
        indices = cubes.clamp(-INDICES // 2, INDICES // 2 - 1).long() + INDICES // 2
        numbers = (indices[:, 0] * INDICES + indices[:, 1]) * INDICES + indices[:, 2]
        _, cube = torch.unique(numbers, return_inverse=True)
        sums += torch.zeros_like(sums).index_add_(1, cube, values.double())[:, cube]
    return sums
