"""Scoring: the numbers that a protocol takes of two images, with PyTorch."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import torch
from torch import Tensor

from .color_correction import color_corrected
from .metric import MINIMUM_SIZE, Compared, Metric
from .protocol import Protocol


@torch.no_grad()
def scored(
    protocol: Protocol,
    prediction: Tensor,
    target: Tensor,
    masks: Sequence[Tensor | None],
    only: Collection[str] | None = None,
) -> list[dict[str, float | None]]:
    """`Protocol.scores`."""
    for mask in masks:
        _check(prediction, target, mask)
    prediction = _quantized(prediction, protocol.quantization)
    found: list[dict[str, float | None]] = [dict.fromkeys(_wanted(protocol.metrics, only)) for _ in masks]
    shown = [number for number, mask in enumerate(masks) if mask is None or mask.any()]
    parts = [(prediction, _wanted(protocol.plain, only))]
    if corrected := _wanted(protocol.corrected, only):
        parts.append((color_corrected(prediction, target), corrected))
    for picture, metrics in parts if shown else []:
        regions = [_region(picture, target, masks[number], protocol.masking) for number in shown]
        for name, metric in metrics.items():
            for number, value in zip(shown, metric.values(regions, protocol), strict=True):
                found[number][name] = value
    for scores, mask in zip(found, masks, strict=True):
        if mask is not None:
            scores["fraction"] = float(mask.double().mean())
    return found


def _wanted(metrics: Mapping[str, Metric], only: Collection[str] | None) -> dict[str, Metric]:
    return {name: metric for name, metric in metrics.items() if only is None or name in only}


def _region(prediction: Tensor, target: Tensor, mask: Tensor | None, masking: str) -> Compared:
    """What metrics are taken of inside the mask, which is not empty, or of the full image."""
    if mask is None or masking != "white":
        return Compared(prediction, target, mask)
    inside = mask[..., None]
    return Compared(prediction.where(inside, 1.0), target.where(inside, 1.0), None)


def _quantized(image: Tensor, quantization: str) -> Tensor:
    """The image as a PNG would give it back. Truncation forgives the last bits of k / 255 · 255."""
    if quantization == "none":
        return image
    levels = image.clamp(0, 1) * 255 + (0.5 if quantization == "round" else 1e-3)
    return levels.floor() / 255


def _check(prediction: Tensor, target: Tensor, mask: Tensor | None) -> None:
    for name, image in (("prediction", prediction), ("target", target)):
        if not isinstance(image, Tensor) or not image.is_floating_point():
            given = image.dtype if isinstance(image, Tensor) else type(image).__name__
            raise TypeError(f"{name} is {given}, expected a floating-point tensor in [0, 1]; divide bytes by 255")
        if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < MINIMUM_SIZE:
            raise ValueError(
                f"{name} has shape {tuple(image.shape)}, expected [H, W, 3] of at least {MINIMUM_SIZE}×{MINIMUM_SIZE}"
            )
        bad = int((~image.isfinite()).sum())
        if bad:
            raise ValueError(f"{name} has {bad} values of {image.numel()} that are not finite: it cannot be scored")
    if prediction.shape != target.shape:
        raise ValueError(f"prediction is {tuple(prediction.shape)}, target {tuple(target.shape)}: sizes must agree")
    if target.min() < 0 or target.max() > 1:
        raise ValueError(f"target spans [{float(target.min()):g}, {float(target.max()):g}], expected values in [0, 1]")
    if mask is not None and mask.dtype != torch.bool:
        raise TypeError(f"mask is {mask.dtype}, expected torch.bool, True inside the region")
    if mask is not None and mask.shape != target.shape[:2]:
        raise ValueError(f"mask has shape {tuple(mask.shape)}, expected the image's {tuple(target.shape[:2])}")
