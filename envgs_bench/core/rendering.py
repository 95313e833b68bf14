"""Rendering: what rasterize and trace return."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from torch import Tensor


@dataclass
class Statistics:
    """What one pass learned of each primitive. Without gradients; densification and pruning read it.

    `position_gradients` is filled by the backward pass (None before, and where the set's means require no gradient):
    Σ over hits of t·∂L/∂mean, world frame, where t is the hit's distance along its ray. `rasterize` leaves some out
    where it is given `low_pass_statistics=False` or `color_statistics=True`. A method's densification criterion is its
    norm times a constant: W/(2·f) gives 3DGS's gradient of the projected center, ½ gives the EnvGS paper's (Sec. 5.1).
    """

    weights: Tensor
    """[N] Σ over hits of the blending weight T·α; > 0 where the primitive was seen."""
    position_gradients: Tensor | None = None
    """[N, 3]"""


@dataclass
class Rendering:
    """An image ([H, W, …], from rasterize) or a batch of rays ([…], from trace), blended front to back.

    With weights wᵢ = αᵢ·Πⱼ<ᵢ(1 − αⱼ): color = Σ wᵢcᵢ + (1 − Σ wᵢ)·background; alpha = Σ wᵢ; depth = Σ wᵢtᵢ / Σ wᵢ
    (0 where nothing is hit), t along the ray, so camera-frame z for an image; normal = Σ wᵢnᵢ, world frame, each nᵢ
    facing the ray's origin, the sum not normalized; extras = Σ wᵢeᵢ.
    """

    color: Tensor
    """[..., 3]"""
    alpha: Tensor
    """[...]"""
    depth: Tensor
    """[...]"""
    normal: Tensor
    """[..., 3]"""
    extras: Tensor
    """[..., E]"""
    hits: Tensor
    """[...] int32, blended primitives of each pixel or ray."""
    statistics: Statistics
    layers: dict[str, Tensor] = field(default_factory=dict)
    """A method's named parts."""

    def map(self, function: Callable[[Tensor], Tensor]) -> Rendering:
        """The rendering with `function` applied to each of the core's fields: the same rays in another shape."""
        names = ("color", "alpha", "depth", "normal", "extras", "hits")
        changed: dict[str, Any] = {name: function(getattr(self, name)) for name in names}
        return replace(self, **changed)
