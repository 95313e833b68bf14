"""FLIP: the difference seen when two images alternate in place (Andersson et al. 2020), of LDR images.

Both pictures go through the eye's contrast sensitivity in the opponent space YCxCz, and differ by HyAB in L*a*b* with
Hunt's adjustment; where one has edges or points that the other lacks, the difference is amplified. Names and constants
are the paper's. Filters are separable. NVIDIA's evaluator, which the tests hold this against, takes a CPU twice as long
and has no GPU: half a second for a picture of 0.5 megapixels.
"""

from __future__ import annotations

import math
from functools import cache

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.parts import MetricCard

from .metric import Metric

# The paper's default: a 0.7 m wide display of 3840 pixels, 0.7 m away.
PIXELS_PER_DEGREE = 0.7 * 3840 / 0.7 * math.pi / 180
SENSITIVITY = (  # of Y, Cx and Cz: sums of Gaussians, each (a, b) of a·√(π/b)·exp(−π²x²/b), x in degrees
    ((1.0, 0.0047),),
    ((1.0, 0.0053),),
    ((34.1, 0.04), (13.5, 0.025)),
)
FEATURE_WIDTH = 0.082  # w: degrees across the edges that the eye sees best
COLOR_POWER, KNEE, KNEE_VALUE, FEATURE_POWER = 0.7, 0.4, 0.95, 0.5  # q_c, p_c, p_t, q_f
TO_XYZ = (
    (10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794),
    (2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897),
    (1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382),
)


def flip(prediction: Tensor, target: Tensor, mask: Tensor | None = None) -> float:
    """The mean of `flip_map`, over the pixels inside `mask` ([H, W] bool, not empty) where one is given."""
    difference = flip_map(prediction, target)
    return float((difference if mask is None else difference[mask]).double().mean())


@torch.no_grad()
def flip_map(prediction: Tensor, target: Tensor) -> Tensor:
    """LDR-FLIP of every pixel under the default viewing conditions, [H, W] in [0, 1], 0 where no difference is seen.

    Args:
        prediction, target: [H, W, 3], sRGB; values outside [0, 1] are clamped, for FLIP is not defined there.
    """
    images = torch.stack([target, prediction]).float().clamp(0, 1).permute(0, 3, 1, 2)
    opponent = _opponent(_linear(images))
    colors = _color_differences(*_hunt_lab(_filtered(opponent)))
    features = _feature_differences((opponent[:, :1] + 16) / 116)
    return colors ** (1 - features)


def _linear(srgb: Tensor) -> Tensor:
    return torch.where(srgb <= 0.04045, srgb / 12.92, ((srgb.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)


def _matrix(like: Tensor) -> tuple[Tensor, Tensor]:
    """From linear RGB to XYZ as shares of white's, and back."""
    to_xyz = torch.tensor(TO_XYZ, dtype=torch.float64)
    relative = to_xyz / to_xyz.sum(dim=1, keepdim=True)
    return relative.to(like), relative.inverse().to(like)


def _opponent(linear: Tensor) -> Tensor:
    """YCxCz [N, 3, H, W] of linear RGB."""
    x, y, z = torch.einsum("ij,njhw->inhw", _matrix(linear)[0], linear)
    return torch.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], dim=1)


def _filtered(opponent: Tensor) -> Tensor:
    """What the eye resolves of it, in linear RGB within [0, 1]."""
    seen = torch.cat([_sensed(opponent[:, k : k + 1], k) for k in range(3)], dim=1)
    y = (seen[:, 0] + 16) / 116
    relative = torch.stack([y + seen[:, 1] / 500, y, y - seen[:, 2] / 200])
    return torch.einsum("ij,jnhw->nihw", _matrix(opponent)[1], relative).clamp(0, 1)


def _sensed(channel: Tensor, which: int) -> Tensor:
    """One channel [N, 1, H, W] after the eye's filter for it, whose terms are separable each."""
    terms, radius = SENSITIVITY[which], _sensitivity_radius()
    at = torch.arange(-radius, radius + 1, dtype=torch.float64) / PIXELS_PER_DEGREE
    total = channel.new_zeros(())
    parts = []
    for a, b in terms:
        kernel = (-(math.pi**2) / b * at.square()).exp()
        parts.append((a * math.sqrt(math.pi / b), kernel))
    norm = sum(height * float(kernel.sum()) ** 2 for height, kernel in parts)
    for height, kernel in parts:
        total = total + height / norm * _separable(channel, kernel, kernel)
    return total


@cache
def _sensitivity_radius() -> int:
    widest = max(b for terms in SENSITIVITY for _, b in terms)
    return math.ceil(3 * math.sqrt(widest / (2 * math.pi**2)) * PIXELS_PER_DEGREE)


def _separable(values: Tensor, down: Tensor, across: Tensor) -> Tensor:
    """Values [N, 1, H, W] filtered by two odd kernels, the border's values beyond it."""
    tall, wide = len(down) // 2, len(across) // 2
    values = functional.pad(values, (wide, wide, tall, tall), mode="replicate")
    return _filtered_along(_filtered_along(values, across, 3), down, 2)


def _filtered_along(values: Tensor, kernel: Tensor, dim: int) -> Tensor:
    """Sums of shifted values: on a CPU a fifth of the time that torch's convolution takes with one channel."""
    first, *others = kernel.tolist()
    size = values.shape[dim] - len(others)
    total = first * values.narrow(dim, 0, size)
    for shift, weight in enumerate(others, 1):
        total.add_(values.narrow(dim, shift, size), alpha=weight)
    return total


def _hunt_lab(linear: Tensor) -> tuple[Tensor, Tensor]:
    """L*a*b* of linear RGB [2, 3, H, W] with Hunt's adjustment: of either image L and (a, b), [3, H, W]."""
    relative = torch.einsum("ij,njhw->nihw", _matrix(linear)[0], linear)
    knee = 6 / 29
    f = torch.where(relative > knee**3, relative.clamp_min(knee**3) ** (1 / 3), relative / (3 * knee**2) + 4 / 29)
    lightness = 116 * f[:, 1] - 16
    a, b = 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])
    first, second = torch.stack([lightness, 0.01 * lightness * a, 0.01 * lightness * b], dim=1)
    return first, second


def _hyab(first: Tensor, second: Tensor) -> Tensor:
    """Large differences of L*a*b* [3, …] (Abasi et al. 2020), to the power q_c."""
    difference = first - second
    return (difference[0].abs() + difference[1:].norm(dim=0)) ** COLOR_POWER


def _color_differences(first: Tensor, second: Tensor) -> Tensor:
    """Differences [H, W] of L*a*b* in [0, 1]: those up to a share of the largest have most of the range."""
    ends = torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], device=first.device)[:, :, None, None]
    most = _hyab(*_hunt_lab(ends))
    difference, knee = _hyab(first, second), KNEE * most
    beyond = KNEE_VALUE + (difference - knee) / (most - knee) * (1 - KNEE_VALUE)
    return torch.where(difference < knee, KNEE_VALUE / knee * difference, beyond)


def _feature_differences(gray: Tensor) -> Tensor:
    """By how much edges and points of two gray images [2, 1, H, W] differ, [H, W] in [0, 1]."""
    deviation = 0.5 * FEATURE_WIDTH * PIXELS_PER_DEGREE
    radius = math.ceil(3 * deviation)
    at = torch.arange(-radius, radius + 1, dtype=torch.float64)
    smooth = (-at.square() / (2 * deviation**2)).exp()
    found = []
    for kernel in (-at * smooth, (at.square() / deviation**2 - 1) * smooth):  # edges, points
        balanced = torch.where(kernel > 0, kernel / kernel.clamp_min(0).sum(), kernel / -kernel.clamp_max(0).sum())
        across = _separable(gray, smooth / smooth.sum(), balanced)
        down = _separable(gray, balanced, smooth / smooth.sum())
        first, second = torch.hypot(across, down)[:, 0]
        found.append((first - second).abs())
    return (torch.maximum(*found) / math.sqrt(2)) ** FEATURE_POWER


METRIC = Metric(
    MetricCard("FLIP", 3, "lower", explanation="perceived difference, FLIP"),
    value=lambda prediction, target, mask, _: flip(prediction, target, mask),
    definition=lambda _: "LDR-FLIP at 67 pixels a degree, of clamped images",
    constants=["LDR", round(PIXELS_PER_DEGREE, 3)],
)
