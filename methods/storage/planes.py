"""Planes: whole numbers as bytes that compress well, and values as whole numbers of steps.

Numbers are stored as their least, and what each is above it, as planes of bytes: least significant bytes first, no more
of them than the largest needs, none where all numbers are equal.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..gaussians.ordering import Integers

MOST_STEPS = 1 << 53  # beyond, float64 knows no whole numbers apart

Planes = NDArray[np.uint8]


def planes_of(numbers: Integers) -> tuple[Planes, int]:
    """The planes [B, N, …] of whole numbers [N, …], and the least of these."""
    least = int(numbers.min()) if numbers.size else 0
    above = numbers - least
    bytes_needed = (int(above.max()).bit_length() + 7) // 8 if numbers.size else 0
    planes = np.empty((bytes_needed, *numbers.shape), np.uint8)
    for index in range(bytes_needed):
        planes[index] = above >> (8 * index) & 255
    return planes, least


def whole_numbers(planes: Planes, least: int, shape: tuple[int, ...]) -> Integers:
    """The whole numbers of this shape that `planes_of` made these planes of."""
    above = np.zeros(shape, np.int64)
    for index, plane in enumerate(planes):
        above += plane.reshape(shape).astype(np.int64) << (8 * index)
    return above + least


def planes_of_steps(values: NDArray[Any], step: float, name: str) -> tuple[Planes, dict[str, float]]:
    """The planes of values rounded to whole numbers of steps, and what `values_of` needs beside them.

    Raises:
        ValueError: values, which the message calls `name`, are too large.
    """
    numbers = np.rint(values.astype(np.float64) / step)
    if numbers.size and np.abs(numbers).max() > MOST_STEPS:
        raise ValueError(f"{name} reach {np.abs(values).max():.3g}: such a model cannot be stored")
    planes, least = planes_of(numbers.astype(np.int64))
    return planes, {"step": step, "least": least}


def values_of(planes: Planes, steps: Mapping[str, Any], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """The values of this shape, within half a step of those that `planes_of_steps` was given."""
    return whole_numbers(planes, steps["least"], shape) * steps["step"]
