"""Structural similarity in one kernel each way, where the formula takes forty: see ssim.py."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .launch import blocks_for, kernels
from .layout import CONSTANTS

TILE_WIDTH, TILE_HEIGHT = CONSTANTS["SSIM_TILE_WIDTH"], CONSTANTS["SSIM_TILE_HEIGHT"]


def ssim_map(image: Tensor, target: Tensor, taps: tuple[float, ...], pad: int, c1: float, c2: float) -> Tensor:
    """SSIM [H', W', C] of two images [H, W, C] after `pad` zeros on every side, with the 11 `taps` as its window.

    H' = H + 2·pad − 10. Differentiable in `image`. Images that lie in memory a plane a channel are not copied.
    """
    with torch.cuda.device(image.device):
        planes: Tensor = _SsimKernel.apply(image.movedim(2, 0), target.movedim(2, 0), taps, pad, c1, c2)
        return planes.movedim(0, 2)


class _SsimKernel(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, image: Tensor, target: Tensor, taps: tuple[float, ...], pad: int, c1: float, c2: float
    ) -> Tensor:
        (channels, height, width), lost = image.shape, len(taps) - 1 - 2 * pad
        image, target, window = image.contiguous(), target.contiguous(), _on_device(taps, image.device)
        values = image.new_empty(channels, height - lost, width - lost)
        partials = image.new_empty(3, *values.shape) if ctx.needs_input_grad[0] else None
        launch = kernels(("ssim.cu",), image.device)
        launch("ssim_map", _tiles(values), 256, image, target, channels, height, width, pad, window, c1, c2,
               values, partials)  # fmt: skip
        ctx.save_for_backward(image, target, partials, window)
        ctx.pad = pad
        return values

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        image, target, partials, window = ctx.saved_tensors
        g_image = torch.empty_like(image)
        with torch.cuda.device(image.device):
            launch = kernels(("ssim.cu",), image.device)
            launch("differentiate_ssim_map", _tiles(g_image), 256, image, target, gradient.contiguous(), partials,
                   *image.shape, ctx.pad, window, g_image)  # fmt: skip
        return g_image, None, None, None, None, None


def _tiles(planes: Tensor) -> int:
    channels, height, width = planes.shape
    return channels * blocks_for(height, TILE_HEIGHT) * blocks_for(width, TILE_WIDTH)


@lru_cache(maxsize=16)
def _on_device(taps: tuple[float, ...], device: torch.device) -> Tensor:
    return torch.tensor(taps, dtype=torch.float32, device=device)
