"""A separable window over many planes in one kernel, where shifted copies take forty."""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

from .launch import blocks_for, kernels

TILE_WIDTH, TILE_HEIGHT = 32, 16  # as in blur.cu


def blur(images: Tensor, taps: tuple[float, ...], pad: int) -> Tensor:
    """[P, H, W] filtered along rows and columns by the 11 `taps`, after `pad` zeros on every side."""
    planes, height, width = images.shape
    lost = len(taps) - 1 - 2 * pad
    blurred = images.new_empty(planes, height - lost, width - lost)
    tiles = blocks_for(height - lost, TILE_HEIGHT) * blocks_for(width - lost, TILE_WIDTH)
    with torch.cuda.device(images.device):
        launch = kernels(("blur.cu",), images.device)
        window = _on_device(taps, images.device)
        launch("blur_planes", planes * tiles, 256, images.contiguous(), height, width, pad, window, blurred)
    return blurred


@lru_cache(maxsize=16)
def _on_device(taps: tuple[float, ...], device: torch.device) -> Tensor:
    return torch.tensor(taps, dtype=torch.float32, device=device)
