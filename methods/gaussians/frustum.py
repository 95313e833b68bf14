"""Which primitives a camera has in view, whether or not others hide them."""

from __future__ import annotations

import torch
from torch import Tensor

from envgs_bench.core import Camera

REACH = 3.0  # standard deviations
LOW_PASS = 0.5  # px², the variance that the rasterizer's low-pass keeps a projection from falling below


@torch.no_grad()
def in_view(means: Tensor, scales: Tensor, camera: Camera, near: float) -> Tensor:
    """Mask [N] of primitives that reach into the picture: centers [N, 3] and standard deviations [N, 2] or [N, 3].

    As 3DGS and 2DGS count those whose radius on the screen is not 0: the center lies beyond `near`, and a disc of three
    standard deviations around its projection meets the picture. The disc here is that of the largest of the scales, as
    if its axis lay across the view.
    """
    pixels, depths = camera.project(means)
    size = camera.intrinsics.diagonal()[:2].amax() / depths * scales.amax(dim=1)
    reach = REACH * (size.square() + LOW_PASS).sqrt()
    x, y = pixels.unbind(dim=1)
    beside = (x + reach > 0) & (x - reach < camera.width) & (y + reach > 0) & (y - reach < camera.height)
    return (depths > near) & beside
