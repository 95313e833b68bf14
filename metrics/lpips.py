"""LPIPS with VGG-16 (Zhang et al. 2018), version 0.1: a learned distance between deep features."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache, partial

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.parts import MetricCard

from .metric import Compared, Metric
from .vgg16 import load_vgg16, weights_source
from .weights import TORCHVISION_SHA256, shipped_weights, why_unavailable

INPUT_RANGES = ("[0, 1]", "[-1, 1]")

MOST_PIXELS = 1 << 16  # that share a pass

# ImageNet's mean and deviation for images in [−1, 1], as LPIPS rounds them.
_MEAN = (-0.030, -0.088, -0.188)
_DEVIATION = (0.458, 0.448, 0.450)


def lpips(prediction: Tensor, target: Tensor, input_range: str, mask: Tensor | None = None) -> float:
    """Σ over VGG-16's five stages of the mean over space of Σ_c w_c·(f̂_c − ĝ_c)², f̂ and ĝ of unit length.

    Computed where the images lie, 1.5 kB a pixel; a GPU's value is the CPU's to rounding.

    Args:
        prediction, target: [H, W, 3] in [0, 1], at least 16×16 pixels.
        input_range: "[-1, 1]", the images are scaled to it, as LPIPS was trained; "[0, 1]", they are fed as they are,
            as 3D Gaussian Splatting and EnvGS do. The two are different numbers.
        mask: [H, W] bool with at least one pixel inside; every stage's map is upsampled to the image and averaged
            over these pixels.

    Raises:
        WeightsUnavailable: the weights cannot be had here.
    """
    return lpips_of_all([Compared(prediction, target, mask)], input_range)[0]


def lpips_of_all(compared: Sequence[Compared], input_range: str) -> list[float]:
    """`lpips` of each, which are of one size: small pictures share a pass, and what differs by its mask alone has one.

    A pass reads 59 MB of weights, which takes as long as convolving a picture of 64×48 with them.
    """
    sharing: dict[tuple[int, int], list[int]] = {}  # by picture: which of `compared` show it
    for number, each in enumerate(compared):
        sharing.setdefault((id(each.prediction), id(each.target)), []).append(number)
    groups, a_pass = [*sharing.values()], max(1, MOST_PIXELS // compared[0].target[..., 0].numel())
    distances = [0.0] * len(compared)
    # By default a GPU convolves in 10 bits of precision, by algorithms of which some add up in any order.
    with torch.backends.cudnn.flags(enabled=True, deterministic=True, allow_tf32=False):
        for first in range(0, len(groups), a_pass):
            group = groups[first : first + a_pass]
            shown = [compared[numbers[0]] for numbers in group]
            pictures = (torch.stack([each.prediction for each in shown]), torch.stack([each.target for each in shown]))
            for stage in stage_distances(*pictures, input_range):
                for picture, numbers in zip(stage, group, strict=True):
                    for number in numbers:
                        distances[number] += _mean(picture, compared[number].mask)
    return distances


def _mean(stage: Tensor, mask: Tensor | None) -> float:
    """The mean of a stage's map [h, w], or of the map that is upsampled to the mask's size inside the mask."""
    if mask is not None:
        stage = functional.interpolate(stage[None, None], mask.shape, mode="bilinear")[0, 0][mask]
    return float(stage.double().mean())


def stage_distances(predictions: Tensor, targets: Tensor, input_range: str) -> Iterator[Tensor]:
    """Σ_c w_c·(f̂_c − ĝ_c)² at each place of a stage, [B, h, w] of images [B, H, W, 3], stage by stage.

    `lpips`'s arguments otherwise. Differentiable in the predictions.
    """
    if input_range not in INPUT_RANGES:
        raise ValueError(f"unknown input range {input_range!r}, expected one of {', '.join(INPUT_RANGES)}")
    network = load_vgg16(predictions.device)
    # One side at a time: half the memory, and equal images get equal features to the last bit.
    features = [network(_network_input(images, input_range)) for images in (predictions, targets)]
    for first, second, head in zip(*features, _heads_on(predictions.device), strict=True):
        squared = (_unit(first) - _unit(second)).square()
        yield torch.einsum("c,bchw->bhw", head, squared)


@cache
def load_heads() -> tuple[Tensor, ...]:
    """The learned weights of each stage's channels, [C] ≥ 0, as torchmetrics ships them.

    Raises:
        WeightsUnavailable: the installed torchmetrics has no such file.
    """
    state = shipped_weights("lpips_models/vgg.pth", "LPIPS's linear heads", since="1.4")
    return tuple(state[f"lin{stage}.model.1.weight"].flatten() for stage in range(5))


# Copied to a device once: each copy of numbers to a GPU waits for it, and a recorded training step allows none.
@cache
def _heads_on(device: torch.device) -> tuple[Tensor, ...]:
    return tuple(head.to(device) for head in load_heads())


@cache
def _normalization(device: torch.device) -> tuple[Tensor, Tensor]:
    return torch.tensor(_MEAN, device=device), torch.tensor(_DEVIATION, device=device)


def _network_input(images: Tensor, input_range: str) -> Tensor:
    """[B, 3, H, W] of about zero mean and unit deviation, were the images [B, H, W, 3] in [−1, 1]."""
    images = images.float() if input_range == "[0, 1]" else 2 * images.float() - 1
    mean, deviation = _normalization(images.device)
    return ((images - mean) / deviation).permute(0, 3, 1, 2)


def _unit(features: Tensor) -> Tensor:
    """[B, C, H, W] scaled to unit length over the channels; where all are zero they stay so, and get no gradient."""
    return features / (features.square().sum(1, keepdim=True).clamp_min(1e-36).sqrt() + 1e-10)


METRIC = Metric(
    MetricCard("LPIPS", 3, "lower", explanation="learned perceptual distance"),
    value=lambda prediction, target, mask, choices: lpips(prediction, target, choices.lpips_input, mask),
    together=lambda compared, choices: lpips_of_all(compared, choices.lpips_input),
    definition=lambda choices: f"LPIPS-VGG v0.1 on {choices.lpips_input} input",
    constants=["VGG-16", TORCHVISION_SHA256[:8], "0.1"],
    not_computed=partial(why_unavailable, load_heads, weights_source),
    corrected=True,
)
