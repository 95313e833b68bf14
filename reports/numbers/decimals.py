"""Decimal arithmetic for printed numbers: binary floats cannot round a tie as a person with a pencil does."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import ROUND_HALF_UP, Decimal


def decimal(value: float | int | str | Decimal) -> Decimal:
    """The number as it prints (0.1 is 0.1, not its nearest binary fraction)."""
    if isinstance(value, Decimal | str | int):
        return Decimal(value)
    return Decimal(repr(float(value)))


def mean(values: Iterable[float | str | Decimal]) -> Decimal:
    """The unweighted mean, unrounded. Raises ValueError for no values."""
    numbers = [decimal(value) for value in values]
    if not numbers:
        raise ValueError("the mean of no values is undefined")
    return sum(numbers, Decimal(0)) / len(numbers)


def rounded(value: float | str | Decimal, places: int) -> Decimal:
    """`value` with `places` decimals, halves away from zero: the rounding of the paper's tables."""
    return decimal(value).quantize(Decimal(1).scaleb(-places), rounding=ROUND_HALF_UP)
