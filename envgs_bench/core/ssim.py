"""Structural similarity, as a loss and as a measurement: 11×11 Gaussian window of σ 1.5, images in [0, 1].

    SSIM = (2·μ₁μ₂ + C₁)(2·σ₁₂ + C₂) / ((μ₁² + μ₂² + C₁)(σ₁² + σ₂² + C₂)),   C₁ = 0.01², C₂ = 0.03²

per pixel and channel (Wang et al. 2004), moments weighted by the window. σ₁² and σ₂² only ever appear as a sum, so four
images are blurred, not five, and the gradient with respect to one image takes three more: it is written out below, at
half the cost of automatic differentiation. A blur is a sum of shifted copies: on a CPU two to three times faster than
torch's depthwise convolutions at 640×480, as fast at 160×120. kornia's SSIM is the same formula once the images are
padded with zeros, and takes four times as long with its gradient. On a GPU all of it is one kernel of the CUDA backend
each way.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional

from .backends import load_backend
from .contract import ImageKernels

WINDOW = 11  # pixels
SIGMA = 1.5  # pixels
K1, K2 = 0.01, 0.03
PADDINGS = ("zero", "valid")

_RADIUS = WINDOW // 2
_WEIGHTS = [math.exp(-((k - _RADIUS) ** 2) / (2 * SIGMA**2)) for k in range(WINDOW)]
TAPS = tuple(weight / math.fsum(_WEIGHTS) for weight in _WEIGHTS)


def ssim(image: Tensor, target: Tensor, padding: str = "zero", *, backend: str = "auto") -> Tensor:
    """The mean of `ssim_map`, a scalar: 1 where both are equal. Differentiable in `image`."""
    return ssim_map(image, target, padding, backend=backend).mean()


def ssim_map(image: Tensor, target: Tensor, padding: str = "zero", *, backend: str = "auto") -> Tensor:
    """SSIM of every pixel and channel. Differentiable in `image`.

    Args:
        image, target: [H, W, C] in [0, 1], of one floating-point dtype on one device.
        padding: "zero", the border's windows see black beyond the image (3D Gaussian Splatting), or "valid", only
            windows that lie inside the image count (Wang et al. 2004).
        backend: "auto" (by device) or a name, as for `rasterize`; "torch" takes any dtype.

    Returns:
        [H, W, C] for "zero", [H − 10, W − 10, C] for "valid".

    Raises:
        ValueError: shapes, dtypes or devices differ, `target` needs a gradient, the padding is unknown, a valid map
            would be empty, or the backend does not take these images.
        RuntimeError: the backend does not work on this machine.
    """
    if image.ndim != 3 or image.shape != target.shape:
        raise ValueError(f"image {tuple(image.shape)} and target {tuple(target.shape)} must share a shape [H, W, C]")
    if (target.dtype, target.device) != (image.dtype, image.device):
        raise ValueError(
            f"target is {target.dtype} on {target.device}, image {image.dtype} on {image.device}: convert one with "
            ".to()"
        )
    if target.requires_grad:
        raise ValueError("ssim_map gives no gradient for its target: pass target.detach(), or swap the two")
    if padding not in PADDINGS:
        raise ValueError(f"unknown padding {padding!r}, expected one of {', '.join(PADDINGS)}")
    if padding == "valid" and min(image.shape[:2]) < WINDOW:
        raise ValueError(f"a valid SSIM needs at least {WINDOW}×{WINDOW} pixels, got {tuple(image.shape[:2])}")
    pad = _RADIUS if padding == "zero" else 0
    module = load_backend(backend, image.device, image.dtype)
    if isinstance(module, ImageKernels):
        return module.ssim_map(image, target, TAPS, pad, K1**2, K2**2)
    similarity: Tensor = _SsimMap.apply(image, target, pad)
    return similarity


class _SsimMap(torch.autograd.Function):
    """Works in place on its own [C, H, W] temporaries: memory traffic is what a small image's SSIM costs."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, target: Tensor, pad: int) -> Tensor:
        x, y = image.permute(2, 0, 1).contiguous(), target.permute(2, 0, 1).contiguous()
        squares = (x * x).addcmul_(y, y)
        mean_x, mean_y, squares, product = _blur(torch.stack([x, y, squares, x * y]), pad).unbind()
        mean_product = mean_x * mean_y
        mean_squares = (mean_x * mean_x).addcmul_(mean_y, mean_y)
        a2 = product.sub_(mean_product).mul_(2).add_(K2**2)  # 2·σ₁₂ + C₂
        b2 = squares.sub_(mean_squares).add_(K2**2)  # σ₁² + σ₂² + C₂
        a1 = mean_product.mul_(2).add_(K1**2)  # 2·μ₁μ₂ + C₁
        b1 = mean_squares.add_(K1**2)  # μ₁² + μ₂² + C₁
        similarity = (a1 * a2).div_(b1).div_(b2)
        ctx.pad = pad
        ctx.save_for_backward(x, y, mean_x, mean_y, a1, a2, b1, b2, similarity)
        return similarity.permute(1, 2, 0)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, None, None]:
        """The gradients of the blurred x, x² + y² and xy (half of the first and last), blurred back onto the pixels."""
        x, y, mean_x, mean_y, a1, a2, b1, b2, similarity = ctx.saved_tensors
        grad = grad.permute(2, 0, 1)
        weighted = grad * similarity
        scale = (grad / b1).div_(b2)
        to_product = a1 * scale
        to_squares = (weighted / b2).neg_()
        to_mean = (a2 - a1).mul_(mean_y).mul_(scale)
        to_mean.addcmul_(to_squares, mean_x, value=-1).sub_(weighted.div_(b1).mul_(mean_x))
        to_mean, to_squares, to_product = _blur(torch.stack([to_mean, to_squares, to_product]), 2 * _RADIUS - ctx.pad)
        return to_mean.addcmul_(to_squares, x).addcmul_(to_product, y).mul_(2).permute(1, 2, 0), None, None


def _blur(images: Tensor, pad: int) -> Tensor:
    """[..., H, W] filtered by the window's rows and columns, after `pad` zeros on every side."""
    for dim, padding in ((-1, (pad, pad, 0, 0)), (-2, (0, 0, pad, pad))):
        padded = functional.pad(images, padding)
        size = padded.shape[dim] - WINDOW + 1
        images = padded.narrow(dim, 0, size) * TAPS[0]
        for k in range(1, WINDOW):
            images.add_(padded.narrow(dim, k, size), alpha=TAPS[k])
    return images
