"""Morton order: points on a grid along a curve that stays in one neighborhood before it goes to the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]

BITS = 21  # of each axis: three fill 63 bits

# Doubling the gaps between the bits of a number: (shift, the bits that stay).
SPREAD = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def morton_codes(grid: Integers) -> Integers:
    """The place [N] of grid points [N, 3], each coordinate in [0, 2²¹), on the curve: x's bits are the lowest."""
    x, y, z = (_spread(grid[:, axis]) for axis in range(3))
    return x | (y << 1) | (z << 2)


def grid_points(codes: Integers) -> Integers:
    """The grid points [N, 3] at these places [N]: the inverse of `morton_codes`."""
    return np.stack([_gathered(codes >> axis) for axis in range(3)], axis=1)


def grid_of(means: NDArray[np.float64], step: float) -> tuple[NDArray[np.float64], float]:
    """Origin [3] and step of a grid for points [N, 3]: this step, or the finest that reaches over them with its 2²¹."""
    if not len(means):
        return np.zeros(3), step
    low = means.min(0)
    return low, max(step, float((means.max(0) - low).max()) / ((1 << BITS) - 1), float(np.finfo(np.float32).tiny))


def codes_on(grid: tuple[NDArray[np.float64], float], means: NDArray[np.float64]) -> Integers:
    """The places [N] of points [N, 3] on the curve, each at the grid's point nearest to it."""
    origin, step = grid
    return morton_codes(np.rint((means - origin) / step).astype(np.int64))


def along_curve(means: NDArray[np.float32]) -> Integers:
    """The order of points [N, 3] along the curve, on the finest grid."""
    points = means.astype(np.float64)
    return np.argsort(codes_on(grid_of(points, 0.0), points), kind="stable")


def _spread(values: Integers) -> Integers:
    for shift, mask in SPREAD:
        values = (values | (values << shift)) & mask
    return values


def _gathered(values: Integers) -> Integers:
    values = values & SPREAD[-1][1]
    masks = [mask for _, mask in SPREAD[-2::-1]] + [(1 << BITS) - 1]
    for (shift, _), mask in zip(SPREAD[::-1], masks, strict=True):
        values = (values | (values >> shift)) & mask
    return values
