"""PruningBound: what prunings may cost once a model has learned again; where they cost more, they end."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import torch

from envgs_bench.core import Rendering, View
from envgs_bench.core.ssim import ssim
from envgs_bench.parts import BETA

BOUNDS = {"PSNR": 0.1, "PSNR inside reflections": 0.1, "SSIM": 0.002}  # most that views may lose; dB, dB, and of 1


class PruningBound:
    """Whether prunings may go on, by how well views are drawn each time before one.

    Attributes:
        best: the best that each number of BOUNDS has been before any pruning.
        ended: why prunings have ended; "" where they have not.
    """

    def __init__(self) -> None:
        self.best: dict[str, float] = {}
        self.ended = ""

    def allows(self, quality: Mapping[str, float]) -> bool:
        """Whether they may go on with views of this quality: no worse by more than BOUNDS than they have been."""
        lost = {name: self.best.get(name, value) - value for name, value in quality.items()}
        self.best = {name: value + max(lost[name], 0.0) for name, value in quality.items()}
        beyond = [name for name, loss in lost.items() if loss > BOUNDS[name]]
        if beyond and not self.ended:
            self.ended = " and ".join(f"{name} fell by {lost[name]:.3g}, more than {BOUNDS[name]:g}" for name in beyond)
        return not self.ended

    def training_state(self) -> dict[str, Any]:
        return {"best": dict(self.best), "ended": self.ended}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        self.best, self.ended = dict(state["best"]), state["ended"]


def quality_of(drawn: Iterable[tuple[Rendering, View]]) -> dict[str, float]:
    """How pictures show their views, by the keys of BOUNDS: PSNR of all pixels together, and the views' mean SSIM.

    Inside reflections a pixel counts by its β, which is what the picture itself takes for reflection.
    """
    rows, pixels = [], 0
    for picture, view in drawn:
        color, target = picture.color.clamp(0, 1), view.rgb(picture.color.device)
        error = (color - target).square().mean(dim=-1)
        beta = picture.layers[BETA][..., 0] if BETA in picture.layers else torch.zeros_like(error)
        rows.append(torch.stack([error.sum(), (beta * error).sum(), beta.sum(), ssim(color, target)]))
        pixels += error.numel()
    total, reflected, weight, similar = torch.stack(rows).double().sum(dim=0).tolist()
    values = {"PSNR": _decibels(total / pixels), "SSIM": similar / len(rows)}
    if weight > 0:
        values["PSNR inside reflections"] = _decibels(reflected / weight)
    return values


def _decibels(error: float) -> float:
    return -10 * math.log10(max(error, 1e-12))
