"""PSNR: peak signal-to-noise ratio.

scikit-image has the same formula, bit for bit, but its module imports SciPy's statistics: 0.5 s a run.
"""

from __future__ import annotations

import numpy as np
from torch import Tensor

from envgs_bench.parts import MetricCard

from .metric import Metric

CEILING_DB = 100.0  # what equal images score: infinity has no mean and no place in JSON


def psnr(prediction: Tensor, target: Tensor, mask: Tensor | None = None) -> float:
    """−10·log10 of the mean squared error over pixels and channels, in float64, dB, at most `CEILING_DB`.

    A data set's PSNR is the mean of its images' values, never the PSNR of a pooled error.

    Args:
        prediction, target: [H, W, 3], peak value 1.
        mask: [H, W] bool with at least one pixel inside; the error is averaged over these pixels only.
    """
    images = [image.double() if mask is None else image[mask].double() for image in (target, prediction)]
    expected, drawn = (image.cpu().numpy() for image in images)
    with np.errstate(divide="ignore"):
        decibels = 10 * np.log10(1 / np.mean((expected - drawn) ** 2))
    return min(CEILING_DB, float(decibels))


METRIC = Metric(
    MetricCard("PSNR", 2, "higher", "dB", "peak signal-to-noise ratio, dB"),
    value=lambda prediction, target, mask, _: psnr(prediction, target, mask),
    definition=lambda _: "PSNR the mean of per-image values",
    constants=CEILING_DB,
    corrected=True,
)
