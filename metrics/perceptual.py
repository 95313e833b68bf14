"""Perceptual losses: what a method may train with, by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:  # which losses there are is known without torch
    import torch
    from torch import Tensor

PerceptualLoss: TypeAlias = "Callable[[Tensor, Tensor], Tensor]"  # [H, W, 3] in [0, 1], differentiable in the first


def make_perceptual_loss(name: str = "features", device: torch.device | str = "cpu") -> PerceptualLoss:
    """The loss of that name in `PERCEPTUAL_LOSSES`, a function of two [H, W, 3] images in [0, 1], a scalar.

    Raises:
        ValueError: no such loss.
        WeightsUnavailable: by this function, not by the one it returns.
    """
    make = PERCEPTUAL_LOSSES.get(name)
    if make is None:
        raise ValueError(f"unknown perceptual loss {name!r}, expected one of {', '.join(PERCEPTUAL_LOSSES)}")
    import torch

    return make(torch.device(device))


def _features(device: torch.device) -> PerceptualLoss:
    """L_perc = ‖Φ(I) − Φ(I_gt)‖₁ (EnvGS paper, Eq. 10).

    Φ are the features at the end of VGG-16's five stages; the norm is the mean over each stage's values, summed over
    the stages.
    """
    import torch

    from .vgg16 import load_vgg16

    network = load_vgg16(device)
    mean = torch.tensor([0.485, 0.456, 0.406], device=device)
    deviation = torch.tensor([0.229, 0.224, 0.225], device=device)

    def features(image: Tensor) -> list[Tensor]:
        return network(((image - mean) / deviation).permute(2, 0, 1)[None])

    def loss(image: Tensor, target: Tensor) -> Tensor:
        with torch.no_grad():
            expected = features(target)
        differences = [(a - b).abs().mean() for a, b in zip(features(image), expected, strict=True)]
        return torch.stack(differences).sum()

    return loss


def _lpips(device: torch.device) -> PerceptualLoss:
    """LPIPS of images fed as they are, in [0, 1] (EnvGS's released code)."""
    import torch

    from .lpips import load_heads, stage_distances
    from .vgg16 import load_vgg16

    load_vgg16(device), load_heads()  # whatever is missing is missing now

    def loss(image: Tensor, target: Tensor) -> Tensor:
        return torch.stack([stage.mean() for stage in stage_distances(image[None], target[None], "[0, 1]")]).sum()

    return loss


PERCEPTUAL_LOSSES: dict[str, Callable[[torch.device], PerceptualLoss]] = {"features": _features, "lpips": _lpips}
