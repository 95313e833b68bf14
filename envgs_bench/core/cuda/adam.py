"""A step of Adam in one kernel a tensor, see adam.cu."""

from __future__ import annotations

from torch import Tensor

from .launch import aligned, blocks_for, kernels

VALUES_PER_THREAD = 4


def adam_step(
    values: Tensor,
    gradients: Tensor,
    means: Tensor,
    squares: Tensor,
    rate: Tensor,
    steps: Tensor,
    skipped: Tensor | None,
    betas: tuple[float, float],
    epsilon: float,
) -> None:
    """Move `values` by one step, in place, as `means` and `squares` are.

    Args:
        values, means, squares: contiguous float32 of one shape, whose memory begins at 16 bytes.
        gradients: of the same shape.
        rate: [] the learning rate.
        steps: [] how many steps were taken, this one included.
        skipped: [] not 0 where nothing is to change; None: it does.
    """
    gradients, blocks = aligned(gradients.contiguous()), blocks_for(values.numel(), 256 * VALUES_PER_THREAD)
    launch = kernels(("adam.cu",), values.device)
    launch("adam_step", blocks, 256, values, gradients, means, squares, values.numel(), rate, steps, skipped, *betas,
           epsilon)  # fmt: skip
