"""SSIM as a number: the loss's own map, in float64 and where the pictures lie."""

from __future__ import annotations

from torch import Tensor

from envgs_bench.core.ssim import K1, K2, SIGMA, WINDOW, ssim_map
from envgs_bench.parts import MetricCard

from .metric import Metric

_BORDER_IN_WORDS = {"zero": "zero padding", "valid": "on the valid interior"}


def ssim(prediction: Tensor, target: Tensor, padding: str, mask: Tensor | None = None) -> float | None:
    """The mean of the SSIM map over pixels and channels, in float64.

    Args:
        prediction, target: [H, W, 3] in [0, 1], at least 11×11 pixels.
        padding: "zero" or "valid", see `ssim_map`.
        mask: [H, W] bool; the map is averaged where the mask holds the window's center. Windows reach beyond the mask.

    Returns:
        A value in [−1, 1]; None where the mask holds no window's center.
    """
    similarity = ssim_map(prediction.double(), target.double(), padding, backend="torch")
    if mask is None:
        return float(similarity.mean())
    inside = mask
    if padding == "valid":
        border = WINDOW // 2
        inside = inside[border:-border, border:-border]
    return float(similarity[inside].mean()) if inside.any() else None


METRIC = Metric(
    MetricCard("SSIM", 3, "higher", explanation="structural similarity"),
    value=lambda prediction, target, mask, choices: ssim(prediction, target, choices.ssim_padding, mask),
    definition=lambda choices: f"SSIM 11×11 Gaussian σ 1.5, {_BORDER_IN_WORDS[choices.ssim_padding]}",
    constants=[WINDOW, SIGMA, K1, K2],
    corrected=True,
)
