"""SSIM as a number. The formula and its window are core's, which the training loss shares."""

from __future__ import annotations

from torch import Tensor

from envgs_bench.core.ssim import WINDOW, ssim_map


def ssim(prediction: Tensor, target: Tensor, padding: str, mask: Tensor | None = None) -> float | None:
    """The mean of the SSIM map over pixels and channels, in float64.

    Args:
        prediction, target: [H, W, 3] in [0, 1].
        padding: "zero" or "valid", see `ssim_map`.
        mask: [H, W] bool; the map is averaged where the mask holds the window's center. Windows reach beyond the mask.

    Returns:
        A value in [−1, 1]; None where the mask holds no window's center.
    """
    similarity = ssim_map(prediction.double(), target.double(), padding, backend="torch")
    if mask is None:
        return float(similarity.mean())
    if padding == "valid":
        border = WINDOW // 2
        mask = mask[border:-border, border:-border]
    return float(similarity[mask].mean()) if mask.any() else None
