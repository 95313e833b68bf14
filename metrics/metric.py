"""Metric: what a number taken of two images is to protocols and reports, and the choices that it may ask a protocol."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from envgs_bench.parts import MetricCard

if TYPE_CHECKING:  # a run's settings are checked without torch, which takes longer to import than all else
    from torch import Tensor

MINIMUM_SIZE = 16  # pixels along an edge: smaller images vanish in the four poolings of VGG-16


@dataclass(frozen=True)
class Choices:
    """What a protocol decides, for all metrics alike."""

    name: str
    quantization: str  # "none": scored as rendered; "round" or "truncate": clamped, then made 8 bits so
    ssim_padding: str  # "zero" or "valid"
    lpips_input: str  # "[0, 1]" or "[-1, 1]"
    masking: str  # "white": composite, then score the whole image; "normalized": average over the mask
    corrects_color: bool = False  # whether metrics that say so are taken of color-corrected pictures too
    also: tuple[str, ...] = ()  # the metrics that are taken only where a protocol names them


class Compared(NamedTuple):
    """A prediction and its photograph, [H, W, 3] floats, and the mask, [H, W] bool, that a metric is taken inside."""

    prediction: Tensor
    target: Tensor
    mask: Tensor | None


@dataclass(frozen=True)
class Metric:
    """A number taken of a prediction and its photograph."""

    card: MetricCard
    value: Callable[[Tensor, Tensor, Tensor | None, Choices], float | None]
    """Of a prediction and a target, [H, W, 3] floats, sRGB, the target's in [0, 1], the prediction's perhaps beyond;
    inside a mask, [H, W] bool and not empty, or of the full image. None where there is no such number."""
    definition: Callable[[Choices], str]
    """Its part of a protocol's description."""
    constants: Any = None
    """JSON values that the protocols' hashes cover, and so change all of them; None adds nothing to a hash."""
    not_computed: Callable[[], str] = lambda: ""
    """Why it cannot be had on this machine; "" where it can."""
    asked_for: bool = False
    """Whether only protocols take it that name it in `Choices.also`, as it takes as long as all others together."""
    together: Callable[[Sequence[Compared], Choices], list[float]] | None = None
    """`value` of several pictures of one size, where that is quicker than one after the other."""
    corrected: bool = False
    """Whether protocols that correct colors take it of color-corrected pictures too, as cc_<name>."""

    def values(self, compared: Sequence[Compared], choices: Choices) -> list[float | None]:
        """The number of each of these, which are of one size; None where there is none, or it cannot be had here."""
        if self.not_computed():
            return [None] * len(compared)
        if self.together is not None:
            return [*self.together(compared, choices)]
        return [self.value(*each, choices) for each in compared]
