"""LPIPS with VGG-16 (Zhang et al. 2018), version 0.1: a learned distance between deep features."""

from __future__ import annotations

import importlib.util
from functools import cache
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from .vgg16 import WeightsUnavailable, load_vgg16

INPUT_RANGES = ("[0, 1]", "[-1, 1]")

# ImageNet's mean and deviation for images in [−1, 1], as LPIPS rounds them.
_MEAN = (-0.030, -0.088, -0.188)
_DEVIATION = (0.458, 0.448, 0.450)


def lpips(prediction: Tensor, target: Tensor, input_range: str, mask: Tensor | None = None) -> float:
    """Σ over VGG-16's five stages of the mean over space of Σ_c w_c·(f̂_c − ĝ_c)², f̂ and ĝ of unit length.

    Args:
        prediction, target: [H, W, 3] in [0, 1], at least 16×16 pixels.
        input_range: "[-1, 1]", the images are scaled to it, as LPIPS was trained; "[0, 1]", they are fed as they are,
            as 3D Gaussian Splatting and EnvGS do. The two differ by several hundredths.
        mask: [H, W] bool with at least one pixel inside; every stage's map is upsampled to the image and averaged
            over these pixels.

    Raises:
        WeightsUnavailable: the weights cannot be had here.
    """
    if input_range not in INPUT_RANGES:
        raise ValueError(f"unknown input range {input_range!r}, expected one of {', '.join(INPUT_RANGES)}")
    network = load_vgg16(prediction.device)
    images = torch.stack([prediction, target]).float().permute(0, 3, 1, 2)
    if input_range == "[-1, 1]":
        images = 2 * images - 1
    mean, deviation = (images.new_tensor(values)[:, None, None] for values in (_MEAN, _DEVIATION))
    distance = 0.0
    for features, head in zip(network((images - mean) / deviation), load_heads(), strict=True):
        unit = features / (features.square().sum(1, keepdim=True).sqrt() + 1e-10)
        squared = (unit[0] - unit[1]).square()
        stage = torch.einsum("c,chw->hw", head.to(squared.device), squared)
        if mask is not None:
            stage = functional.interpolate(stage[None, None], mask.shape, mode="bilinear")[0, 0][mask]
        distance += float(stage.double().mean())
    return distance


@cache
def load_heads() -> tuple[Tensor, ...]:
    """The learned weights of each stage's channels, [C] ≥ 0, as torchmetrics ships them.

    Raises:
        WeightsUnavailable: the installed torchmetrics has no such file.
    """
    # torchmetrics is not imported: that would take seconds, and torchvision.
    spec = importlib.util.find_spec("torchmetrics")
    folder = Path(spec.origin).parent if spec and spec.origin else Path("torchmetrics (not installed)")
    path = folder / "functional" / "image" / "lpips_models" / "vgg.pth"
    if not path.is_file():
        raise WeightsUnavailable(f"LPIPS's linear heads are not at {path}: install torchmetrics 1.4 or newer")
    state = torch.load(path, map_location="cpu", weights_only=True)
    return tuple(state[f"lin{stage}.model.1.weight"].flatten() for stage in range(5))
