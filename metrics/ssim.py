"""SSIM as a number, by scikit-image. The loss is core's own, differentiable, with the same window and constants."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
from torch import Tensor

from envgs_bench.core.ssim import K1, K2, SIGMA, WINDOW
from envgs_bench.core.threads import workers
from envgs_bench.parts import MetricCard

from .metric import Metric

_BORDER_IN_WORDS = {"zero": "zero padding", "valid": "on the valid interior"}
_BORDER = WINDOW // 2  # pixels; scikit-image's window ends at 3.5 σ, which is here


def ssim(prediction: Tensor, target: Tensor, padding: str, mask: Tensor | None = None) -> float | None:
    """The mean of the SSIM map over pixels and channels, in float64.

    Args:
        prediction, target: [H, W, 3] in [0, 1], at least 11×11 pixels.
        padding: "zero" or "valid", see `ssim_map`.
        mask: [H, W] bool; the map is averaged where the mask holds the window's center. Windows reach beyond the mask.

    Returns:
        A value in [−1, 1]; None where the mask holds no window's center.
    """
    from skimage.metrics import structural_similarity  # takes 0.3 s: for those that score

    zeros = _BORDER if padding == "zero" else 0
    first, second = (
        np.pad(image.double().movedim(2, 0).cpu(), ((0, 0), (zeros, zeros), (zeros, zeros)))
        for image in (target, prediction)
    )
    of_channel = partial(
        structural_similarity,
        gaussian_weights=True,
        sigma=SIGMA,
        use_sample_covariance=False,
        K1=K1,
        K2=K2,
        data_range=1,
        full=True,
    )
    with ThreadPoolExecutor(min(len(first), workers())) as pool:  # NumPy and SciPy work without Python's lock
        padded = np.stack([channel for _, channel in pool.map(of_channel, first, second)], axis=2)
    similarity = padded[_BORDER:-_BORDER, _BORDER:-_BORDER]  # beyond, scikit-image reflects the image
    if mask is None:
        return float(similarity.mean())
    inside = mask.cpu().numpy()
    if padding == "valid":
        inside = inside[_BORDER:-_BORDER, _BORDER:-_BORDER]
    return float(similarity[inside].mean()) if inside.any() else None


METRIC = Metric(
    MetricCard("SSIM", 3, "higher", explanation="structural similarity"),
    value=lambda prediction, target, mask, choices: ssim(prediction, target, choices.ssim_padding, mask),
    definition=lambda choices: f"SSIM 11×11 Gaussian σ 1.5, {_BORDER_IN_WORDS[choices.ssim_padding]}",
    constants=[WINDOW, SIGMA, K1, K2],
    corrected=True,
)
