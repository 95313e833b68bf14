"""PruningBound: what prunings may cost once a model has learned again; where they cost more, there is none."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import torch
from torch import Tensor

from envgs_bench.core import Rendering, View
from envgs_bench.parts import BETA

INSIDE, LPIPS = "PSNR inside reflections", "LPIPS"
BOUNDS = {"PSNR": 0.1, INSIDE: 0.1, LPIPS: 0.0025}  # by how much worse views may be drawn: dB, dB, and LPIPS's own


class PruningBound:
    """Whether there may be a pruning, by how well views are drawn each time before one.

    Attributes:
        best, last: the best that each number of BOUNDS has been when one was due, and what it was the last time.
        share: of the views' squared error the last time, what was not their noise.
        beyond: by what it was worse then than it may be, in words; "" where a pruning was allowed.
    """

    def __init__(self) -> None:
        self.best: dict[str, float] = {}
        self.last: dict[str, float] = {}
        self.share = 1.0
        self.beyond = ""

    def allows(self, quality: Mapping[str, float], share: float = 1.0) -> bool:
        """Whether there may be one with views of this quality: no worse by more than BOUNDS than they have been.

        Of PSNR's bounds only `share`: so far PSNR falls where the error without noise rises by a whole bound.
        """
        self.last, self.share = dict(quality), share
        better = {name: min if name == LPIPS else max for name in quality}
        self.best = {name: better[name](self.best.get(name, value), value) for name, value in quality.items()}
        lost = {name: abs(self.best[name] - value) for name, value in quality.items()}
        most = {name: BOUNDS[name] * (1.0 if name == LPIPS else share) for name in quality}
        words = [f"{name} {loss:.3g}, more than {most[name]:.3g}" for name, loss in lost.items() if loss > most[name]]
        self.beyond = " and ".join(words)
        return not words

    @property
    def seen(self) -> str:
        """What was seen the last time, beside the best: in words."""
        return ", ".join(f"{name} {value:.4g} (at best {self.best[name]:.4g})" for name, value in self.last.items())

    def training_state(self) -> dict[str, Any]:
        return {"best": dict(self.best), "last": dict(self.last), "share": self.share, "beyond": self.beyond}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        self.best, self.last = dict(state["best"]), dict(state["last"])
        self.share, self.beyond = state["share"], state["beyond"]


def quality_of(
    drawn: Iterable[tuple[Rendering, View]], lpips: Callable[[Tensor, Tensor], Tensor] | None
) -> dict[str, float]:
    """How pictures show their views, by the keys of BOUNDS: PSNR of all pixels together, and the views' mean LPIPS.

    Inside reflections a pixel counts by its β, which is what the picture itself takes for reflection.

    Args:
        lpips: of a picture and its target, [H, W, 3] in [0, 1]; None: not asked.
    """
    rows, pixels = [], 0
    for picture, view in drawn:
        color, target = picture.color.clamp(0, 1), view.rgb(picture.color.device)
        error = (color - target).square().mean(dim=-1)
        beta = picture.layers[BETA][..., 0] if BETA in picture.layers else torch.zeros_like(error)
        apart = torch.zeros_like(error[0, 0]) if lpips is None else lpips(color, target)
        rows.append(torch.stack([error.sum(), (beta * error).sum(), beta.sum(), apart]))
        pixels += error.numel()
    total, reflected, weight, apart_in_all = torch.stack(rows).double().sum(dim=0).tolist()
    values = {"PSNR": _decibels(total / pixels)}
    if lpips is not None:
        values[LPIPS] = apart_in_all / len(rows)
    if weight > 0:
        values[INSIDE] = _decibels(reflected / weight)
    return values


def _decibels(error: float) -> float:
    return -10 * math.log10(max(error, 1e-12))
