"""DISTS with VGG-16 (Ding et al. 2020): a learned distance that forgives another sample of the same texture."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, partial

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from envgs_bench.parts import MetricCard

from .metric import Metric
from .vgg16 import load_vgg16, weights_source
from .weights import shipped_weights, why_unavailable

CHANNELS = (3, 64, 128, 256, 512, 512)  # of the image and of the five stages
STABILIZER = 1e-6  # c₁ and c₂
_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # ImageNet's


def dists(prediction: Tensor, target: Tensor) -> float:
    """1 − Σ over the image and VGG-16's five stages of Σ_c α_c·l_c + β_c·s_c, at the pictures' own size.

    l = (2·μ_x·μ_y + c₁) / (μ_x² + μ_y² + c₁) compares a channel's means, s = (2·σ_xy + c₂) / (σ_x² + σ_y² + c₂) its
    covariance over space; α and β are learned and sum to 1. Between stages an L2 pooling stands for the largest value.

    Args:
        prediction, target: [H, W, 3] in [0, 1], at least 16×16 pixels.

    Raises:
        WeightsUnavailable: the weights cannot be had here.
    """
    alpha, beta = load_shares()
    distance = 1.0
    # By default a GPU convolves in 10 bits of precision, by algorithms of which some add up in any order.
    with torch.backends.cudnn.flags(enabled=True, deterministic=True, allow_tf32=False):
        pairs = zip(_features(prediction), _features(target), alpha, beta, strict=True)
        for first, second, of_means, of_structure in pairs:
            x, y = first.double().flatten(1), second.double().flatten(1)  # [C, H·W]
            mean_x, mean_y = x.mean(1), y.mean(1)
            luminance = (2 * mean_x * mean_y + STABILIZER) / (mean_x**2 + mean_y**2 + STABILIZER)
            covariance = (x * y).mean(1) - mean_x * mean_y
            spread = (x - mean_x[:, None]).square().mean(1) + (y - mean_y[:, None]).square().mean(1)
            structure = (2 * covariance + STABILIZER) / (spread + STABILIZER)
            distance -= float((of_means.to(x) * luminance + of_structure.to(x) * structure).sum())
    return distance


@cache
def load_shares() -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """α and β of each stage's channels, [C] ≥ 0, all together 1, of the weights that torchmetrics ships.

    Raises:
        WeightsUnavailable: the installed torchmetrics has no such file.
    """
    state = shipped_weights("dists_models/weights.pt", "DISTS's weights of channels", since="1.9")
    alpha, beta = (state[name].flatten().double() for name in ("alpha", "beta"))
    total = alpha.sum() + beta.sum()
    return (alpha / total).split(CHANNELS), (beta / total).split(CHANNELS)


def _features(image: Tensor) -> Iterator[Tensor]:
    """The image [3, H, W], and the features at the end of each stage, [C, H / 2^k, W / 2^k]."""
    image = image.float().permute(2, 0, 1)
    yield image
    mean, deviation = (image.new_tensor(values)[:, None, None] for values in (_MEAN, _DEVIATION))
    features = ((image - mean) / deviation)[None]
    for layer in load_vgg16(image.device).features:
        if isinstance(layer, nn.MaxPool2d):
            yield features[0]
            features = l2_pooled(features)
        else:
            features = layer(features)
    yield features[0]


def l2_pooled(features: Tensor) -> Tensor:
    """The root of the squares blurred by a Hann window of three pixels, every second one, [1, C, H / 2, W / 2]."""
    window = torch.from_numpy(np.outer(*2 * [np.hanning(5)[1:-1]])).to(features)
    kernel = (window / window.sum()).expand(features.shape[1], 1, 3, 3)
    squares = functional.conv2d(features.square(), kernel, stride=2, padding=1, groups=features.shape[1])
    return (squares + 1e-12).sqrt()


METRIC = Metric(
    MetricCard("DISTS", 3, "lower", explanation="learned distance of structure and texture"),
    # Both pictures are white outside of a mask, or the protocol does not take it.
    value=lambda prediction, target, mask, choices: dists(prediction, target),
    definition=lambda _: "DISTS at the pictures' own size",
    asked_for=True,
    not_computed=partial(why_unavailable, load_shares, weights_source),
)
