"""FLIP: the difference seen when two images alternate in place (Andersson et al. 2020), by NVIDIA's own evaluator."""

from __future__ import annotations

import flip_evaluator
import numpy as np
import torch
from torch import Tensor

from envgs_bench.parts import MetricCard

from .metric import Metric

# The evaluator's default: a 0.7 m wide display of 3840 pixels, 0.7 m away.
PIXELS_PER_DEGREE = 0.7 * 3840 / 0.7 * np.pi / 180


def flip(prediction: Tensor, target: Tensor, mask: Tensor | None = None) -> float:
    """The mean of `flip_map`, over the pixels inside `mask` ([H, W] bool, not empty) where one is given."""
    difference = flip_map(prediction, target)
    return float((difference if mask is None else difference[mask.cpu()]).double().mean())


def flip_map(prediction: Tensor, target: Tensor) -> Tensor:
    """LDR-FLIP of every pixel under the default viewing conditions, [H, W] in [0, 1], 0 where no difference is seen.

    Args:
        prediction, target: [H, W, 3], sRGB; values outside [0, 1] are clamped, for FLIP is not defined there.
    """
    images = [np.ascontiguousarray(image.clamp(0, 1).float().cpu().numpy()) for image in (target, prediction)]
    difference, _, _ = flip_evaluator.evaluate(
        *images, "LDR", applyMagma=False, computeMeanError=False, parameters={"ppd": float(PIXELS_PER_DEGREE)}
    )
    return torch.from_numpy(difference[..., 0])


METRIC = Metric(
    MetricCard("FLIP", 3, "lower", explanation="perceived difference, FLIP"),
    value=lambda prediction, target, mask, _: flip(prediction, target, mask),
    definition=lambda _: "LDR-FLIP at 67 pixels a degree, of clamped images",
    constants=["LDR", round(PIXELS_PER_DEGREE, 3)],
)
