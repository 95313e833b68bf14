"""How a native backend's passes become part of torch's graph.

A pass draws one image or one batch of rays, and can differentiate what it drew. It is made for one call by a
backend that computes derivatives itself (`cpu`, `cuda`); here is all that such a backend shares with torch.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from .gaussians import GaussianSet
from .rendering import Rendering, Statistics


class SetTensors(NamedTuple):
    """A GaussianSet's fields without gradients, contiguous; extras [N, 0] where the set has none."""

    means: Tensor
    quaternions: Tensor
    scales: Tensor
    opacities: Tensor
    sh: Tensor
    extras: Tensor

    @classmethod
    def of(cls, gaussians: GaussianSet) -> SetTensors:
        extras = gaussians.extras
        if extras is None:
            extras = gaussians.means.new_zeros(len(gaussians), 0)
        fields = (gaussians.means, gaussians.quaternions, gaussians.scales, gaussians.opacities, gaussians.sh, extras)
        return cls(*(field.detach().contiguous() for field in fields))

    @property
    def sh_rows(self) -> int:
        """How many rows of three floats a primitive's colors have."""
        return self.sh.shape[1] * self.sh.shape[2] // 3


class Planes(NamedTuple):
    """A pass's outputs over P pixels or rays, one plane a channel: what kernels write and image losses read."""

    color: Tensor  # [3, P]
    alpha: Tensor  # [P]
    depth: Tensor  # [P]
    normal: Tensor  # [3, P]
    extras: Tensor  # [E, P]

    @classmethod
    def empty(cls, like: Tensor, pixels: int, extras: int) -> Planes:
        return cls(*(like.new_empty(shape) for shape in ((3, pixels), pixels, pixels, (3, pixels), (extras, pixels))))


class PassOutput(NamedTuple):
    planes: Planes
    hits: Tensor  # [P] int32
    weights: Tensor  # [N]


class Gradients(NamedTuple):
    """∂L/∂ of what a pass drew from; `origins` and `directions` [P, 3] are None for an image."""

    set: SetTensors
    position_gradients: Tensor  # [N, 3], see Statistics
    origins: Tensor | None = None
    directions: Tensor | None = None


class Pass(Protocol):
    def forward(self, keep: bool) -> PassOutput:
        """Draws; keeps what backward() needs only if `keep`."""

    def backward(self, planes: Planes, gradients: tuple[Tensor | None, ...]) -> Gradients:
        """From the planes of forward() and ∂L/∂ of each, None for zero."""


INPUTS_FROM = 4  # of _Draw's arguments, those that gradients are asked of


class _Draw(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, draw_pass: Pass, slot: list[Statistics], keep: bool, color_statistics: bool, *inputs: Tensor | None
    ) -> tuple[Tensor, ...]:
        drawn = draw_pass.forward(keep)
        ctx.draw_pass, ctx.slot, ctx.color_statistics = draw_pass, slot, color_statistics
        # The pass reads the inputs again: saved, they are refused where they have changed in place by then.
        ctx.save_for_backward(*drawn.planes, *inputs)
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(drawn.hits, drawn.weights)
        return (*drawn.planes, drawn.hits, drawn.weights)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        planes = Planes(*ctx.saved_tensors[: len(Planes._fields)])
        contiguous = tuple(g if g is None else g.contiguous() for g in gradients[:5])
        result = ctx.draw_pass.backward(planes, contiguous)
        if ctx.needs_input_grad[INPUTS_FROM]:  # the means
            counted = result.position_gradients
            if ctx.color_statistics and any(g is not None for g in contiguous[1:]):
                counted = ctx.draw_pass.backward(planes, (contiguous[0], None, None, None, None)).position_gradients
            ctx.slot[0].position_gradients = counted
        wanted = (*result.set, result.origins, result.directions)
        return (
            None,
            None,
            None,
            None,
            *(g if need else None for g, need in zip(wanted, ctx.needs_input_grad[INPUTS_FROM:], strict=True)),
        )


def draw(
    draw_pass: Pass,
    gaussians: GaussianSet,
    origins: Tensor | None = None,
    directions: Tensor | None = None,
    color_statistics: bool = False,
) -> Rendering:
    """The pass's Rendering, one value a pixel ([P, …]), differentiable in the set and the rays.

    Position gradients are linear in those of the outputs: with `color_statistics` a second backward pass, of color's
    alone, finds them.
    """
    inputs = (
        gaussians.means,
        gaussians.quaternions,
        gaussians.scales,
        gaussians.opacities,
        gaussians.sh,
        gaussians.extras,
        origins,
        directions,
    )
    keep = torch.is_grad_enabled() and any(x is not None and x.requires_grad for x in inputs)
    slot: list[Statistics] = []
    color, alpha, depth, normal, extras, hits, weights = _Draw.apply(draw_pass, slot, keep, color_statistics, *inputs)
    slot.append(Statistics(weights))
    return Rendering(color.T, alpha, depth, normal.T, extras.T, hits, slot[0])
