"""What lookups of maps and tables have in common."""

from __future__ import annotations

from torch import Tensor


def texel_below(places: Tensor) -> Tensor:
    """The whole numbers below places in texels, without a gradient; 0 where a place is NaN.

    A training step replayed from a graph that lacked room for its lists shows NaN everywhere, and is not taken. An
    index made of that would end a run on a GPU. The shares that a lookup takes of its texels stay NaN, and so does its
    value.
    """
    return places.detach().floor().nan_to_num(0.0)
