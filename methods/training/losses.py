"""The loss terms of EnvGS (paper Sec. 4.3, Eqs. 7 to 11). Images are [H, W, 3] in [0, 1]; every loss is a scalar."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core.ssim import ssim

SSIM_SHARE = 0.2  # SSIM's part of the photometric loss, as in 3DGS


def photometric_loss(image: Tensor, target: Tensor, *, backend: str = "auto") -> Tensor:
    """L_rgb = 0.8·mean |I − I_gt| + 0.2·(1 − SSIM), the SSIM by the core's `backend`."""
    difference = (image - target).abs().mean()
    return (1 - SSIM_SHARE) * difference + SSIM_SHARE * (1 - ssim(image, target, backend=backend))


def normal_loss(normal: Tensor, reference: Tensor, weight: Tensor | None = None) -> Tensor:
    """Mean over pixels of 1 − n·N (Eqs. 7 and 9).

    Args:
        normal: [H, W, 3] blended normals as rendered, Σ wᵢnᵢ: where a surface is not opaque they are shorter than 1.
        reference: [H, W, 3] unit normals in the same frame; zero where unknown: such pixels count as no error.
        weight: [H, W] weight of a pixel's error, 1 where None.
    """
    known = reference.detach().any(-1).to(normal)
    error = known - (normal * reference).sum(-1)
    return (error if weight is None else error * weight).mean()


def normal_distance(normal: Tensor, reference: Tensor, weight: Tensor | None = None) -> Tensor:
    """Mean over pixels of the L1 distance Σ|n − N|, with `normal_loss`'s arguments.

    Its gradient does not vanish as the angle does, which 1 − cos's does (EnvGS's released code adds both).
    """
    known = reference.detach().any(-1).to(normal)
    error = (normal - reference).abs().sum(-1) * known
    return (error if weight is None else error * weight).mean()


def edge_aware_smoothness(normal: Tensor, image: Tensor) -> Tensor:
    """Mean over pixels of Σ |∂n|·exp(−|∂I|) in both directions, differences of neighboring pixels (Ref-Gaussian).

    Args:
        normal: [H, W, 3] blended normals as rendered.
        image: [H, W, 3] in [0, 1], at whose edges normals may turn; receives no gradient.
    """
    total = normal.new_zeros(())
    for axis in (0, 1):
        turns, edges = (values.diff(dim=axis).abs() for values in (normal, image.detach()))
        if turns.numel():
            total = total + (turns * (-edges).exp()).sum(-1).mean()
    return total


def nearness(depth: Tensor) -> Tensor:
    """clip(1 − normalized depth, 0, 1), [H, W]: 1 at the nearest hits, 0 at the farthest; 1 everywhere on a flat map.

    A weight for the normal losses that spares far surfaces. Depth is normalized to the range of the pixels with a hit,
    without the nearest and the farthest hundredth of them (EnvGS's released code, which takes pixels without one too).
    """
    depth = depth.detach()
    ordered = depth.flatten().sort().values
    misses = (ordered <= 0).sum()
    count = ordered.numel() - misses
    rank = (count // 100).clamp_min(1)
    # By gather, which does not wait for a GPU to say how many hits there are.
    ends = torch.stack([misses + rank - 1, ordered.numel() - rank]).clamp_max(ordered.numel() - 1)
    low, high = ordered.gather(0, ends).unbind()
    weight = (1 - (depth - low) / (high - low).clamp_min(1e-6 * high)).clamp(0, 1)
    return torch.where(count > 0, weight, 1.0)


def training_psnr(image: Tensor, target: Tensor) -> Tensor:
    """−10·log10 of the mean squared error of the clamped image, for progress displays only."""
    return -10 * torch.log10(functional.mse_loss(image.detach().clamp(0, 1), target).clamp_min(1e-12))
