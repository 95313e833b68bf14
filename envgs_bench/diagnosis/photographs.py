"""How well the training photographs were taken: noise, lost detail and compression, told from pictures alone.

A method fits whatever it is shown, so that none of these shows in its losses. Test views, of the same camera, may not
tell of them either.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import View

VIEWS = 12  # that are looked at, evenly over their order
PATCH = 7  # pixels along a patch that noise is told in
FLATTEST = 0.1  # share of the patches that show hardly anything but noise
DARKEST, BRIGHTEST = 0.1, 0.9  # a patch's mean beyond which noise is cut off
LEAST_PATCHES = 100  # below which texture is not told from noise
WIDTH = 160  # pixels, about, at which detail is judged: many photographs have none as fine as their pixels
LEAST_EDGE = 40  # pixels of a picture in which detail is judged
FINEST, COARSER = (0.3, 0.5), (0.1, 0.2)  # cycles a pixel
BLOCK = 8  # pixels along a block of JPEG


@dataclass(frozen=True)
class Photographs:
    """Of the median view.

    Attributes:
        noise: standard deviation of a pixel, in [0, 1].
        detail: power of what is two or three pixels long as a share of what is five to ten, in pictures of about
            `WIDTH` pixels; 1 where nothing is shown, or in few pixels.
        blockiness: by how much steps at blocks' borders exceed their neighbors', as a share of the mean step.
    """

    noise: float
    detail: float
    blockiness: float

    @classmethod
    @torch.no_grad()
    def of(cls, views: Sequence[View], device: torch.device | str = "cpu") -> Photographs:
        """Of these training views, looked at on `device`."""
        rows = torch.linspace(0, len(views) - 1, min(len(views), VIEWS)).round().long().tolist()
        greens = [views[row].image[..., 1].to(device).float() / 255 for row in rows]
        return cls(*(statistics.median(map(judge, greens)) for judge in (noise, detail, blockiness)))


def noise(green: Tensor) -> float:
    """The standard deviation of a picture [H, W] where it is flattest; 0 where too little is there to tell by.

    By the difference of two Laplacians (Immerkær 1996), second differences along both sides: little is left of edges.
    """
    if min(green.shape) < PATCH + 2:
        return 0.0
    differences = green.diff(n=2, dim=0).diff(n=2, dim=1)[None] / 6
    variance, mean = (
        functional.avg_pool2d(values, PATCH, stride=PATCH // 2)
        for values in (differences.square(), green[None, 1:-1, 1:-1])
    )
    told = variance[(mean > DARKEST) & (mean < BRIGHTEST)]
    return float(told.quantile(FLATTEST)) ** 0.5 if len(told) >= LEAST_PATCHES else 0.0


def detail(green: Tensor) -> float:
    """See `Photographs.detail`, of a picture [H, W]."""
    if min(green.shape) < LEAST_EDGE:
        return 1.0
    shrink = max(1, round(min(green.shape[1] / WIDTH, green.shape[0] / LEAST_EDGE)))
    small = functional.avg_pool2d(green[None], shrink)[0]
    fading_down, fading_right = (torch.hann_window(size, device=green.device) for size in small.shape)
    power = torch.fft.fft2((small - small.mean()) * fading_down[:, None] * fading_right).abs().square()
    down, right = (torch.fft.fftfreq(size, device=green.device) for size in small.shape)
    cycles = torch.hypot(down[:, None], right)
    fine, coarse = (power[(low < cycles) & (cycles < high)].mean() for low, high in (FINEST, COARSER))
    return float(fine / coarse) if coarse > 0 else 1.0


def blockiness(green: Tensor) -> float:
    """See `Photographs.blockiness`, of a picture [H, W] that JPEG cut into blocks from its upper left corner on."""
    if min(green.shape) < 2 * BLOCK + 2:
        return 0.0
    return 0.5 * (_blockiness_along(green) + _blockiness_along(green.T))


def _blockiness_along(green: Tensor) -> float:
    steps = (green[:, 1:] - green[:, :-1]).abs().mean(dim=0)  # [k]: from column k to the next
    excess = steps[1:-1] - 0.5 * (steps[:-2] + steps[2:])
    return float(excess[BLOCK - 2 :: BLOCK].mean() / steps.mean().clamp_min(1e-6))
