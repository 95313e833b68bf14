"""PSNR: peak signal-to-noise ratio."""

from __future__ import annotations

import math

from torch import Tensor

CEILING_DB = 100.0  # what equal images score: infinity has no mean and no place in JSON


def psnr(prediction: Tensor, target: Tensor, mask: Tensor | None = None) -> float:
    """−10·log10 of the mean squared error over pixels and channels, dB, at most `CEILING_DB`.

    A data set's PSNR is the mean of its images' values, never the PSNR of a pooled error.

    Args:
        prediction, target: [H, W, 3], peak value 1.
        mask: [H, W] bool with at least one pixel inside; the error is averaged over these pixels only.
    """
    squared_error = (prediction.double() - target.double()).square()
    mean = float((squared_error if mask is None else squared_error[mask]).mean())
    return CEILING_DB if mean == 0 else min(CEILING_DB, -10 * math.log10(mean))
