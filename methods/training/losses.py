"""What a training step minimizes (EnvGS paper Sec. 4.3, Eqs. 7 to 11), by the settings on a run's clock.

Images are [H, W, 3] in [0, 1]; every loss is a scalar.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Rendering, Scene, View, depth_normals
from envgs_bench.core.ssim import ssim
from envgs_bench.core.vectors import unit
from envgs_bench.parts import MONO, PERCEPTUAL

from ..settings import GaussianSettings
from .schedule import Schedule

SSIM_SHARE = 0.2  # SSIM's part of the photometric loss, as in 3DGS
MAY_MIRROR = "may_mirror"  # a layer of a picture: how much of a pixel may, [H, W], where normals are weighed by that
PRUNED_SSIM_SHARE = 0.35  # … of a set that is pruned: fine texture, which goes first, is little of an error a pixel


@dataclass(frozen=True)
class TrainingLoss:
    """L = L_rgb + L_norm + L_mono + L_perc, each with its weight and from a step of its own on."""

    settings: GaussianSettings
    schedule: Schedule
    normal_weight: float = 1.0  # × L_mono: what the views' normals are worth
    beside_noise: float = 1.0  # of the views' squared error, what was not their noise as prunings began

    def began(self, step: int) -> tuple[bool, bool, bool, float]:
        """Whether L_norm, L_mono and L_perc may count as of a step, and SSIM's share of the photometric loss then."""
        s, at = self.settings, self.schedule.at
        starts = s.normal_from, s.rule.mono_from, s.rule.perceptual_from
        normal, mono, perceives = (step > at(start) for start in starts)
        pruned = s.prune_error > 0 and step > at(s.prune_from)
        return normal, mono, perceives, pruned_ssim_share(self.beside_noise) if pruned else SSIM_SHARE

    def terms(
        self,
        rendering: Rendering,
        target: Tensor,  # [H, W, 3] in [0, 1]
        view: View,
        step: int,
        trusted: Callable[[Rendering], Tensor | None] | None,
        perceptual: Callable[[Tensor, Tensor], Tensor] | None,
    ) -> dict[str, Tensor]:
        """The weighted terms by name, scalars.

        Args:
            view: whose camera and normals are on the device of `target`.
            trusted: how much the view's own normals count at each pixel, [H, W] or None; asked where they do. None: all
                alike.
            perceptual: what L_perc is of an image and its target; None without it.
        """
        s = self.settings
        normal, mono, perceives, share = self.began(step)
        terms = {"rgb": photometric_loss(rendering.color, target, share, backend=s.backend)}
        weight = self.pixel_weights(rendering)
        if normal and s.normal_weight > 0:
            terms["normal"] = s.normal_weight * self._depth_error(rendering, view, weight)
        if mono and s.mono_weight > 0 and view.normal is not None:
            confidence = trusted(rendering) if trusted is not None else None
            if weight is not None:
                confidence = weight if confidence is None else confidence * weight
            mono_weight = s.mono_weight * self.normal_weight * self.schedule.rate_scale
            terms[MONO] = mono_weight * self._mono_error(rendering, view.normal, confidence)
        if perceives and perceptual and s.perceptual_weight > 0:
            terms[PERCEPTUAL] = s.perceptual_weight * perceptual(rendering.color, target)
        return terms

    def pixel_weights(self, rendering: Rendering) -> Tensor | None:
        """What both normal losses count by at each pixel, [H, W]; None: alike everywhere."""
        match self.settings.rule.normal_weighting:
            case "depth":
                return nearness(rendering.depth)
            case "alpha":
                return rendering.alpha.detach()
            case "eroded":
                return eroded(rendering.alpha.detach())
            case "mirror":
                return rendering.layers.get(MAY_MIRROR)
        return None

    def _depth_error(self, rendering: Rendering, view: View, weight: Tensor | None) -> Tensor:
        """Between the rendered normals and those of the depth map (Eq. 7)."""
        reference = depth_normals(rendering.depth, view.camera, backend=self.settings.backend)
        if self.settings.rule.normal_reference == "alpha":
            reference = reference * rendering.alpha.detach()[..., None]
        normal = unit(rendering.normal) if self.settings.rule.normal_rendered == "unit" else rendering.normal
        return normal_loss(normal, reference, weight)

    def _mono_error(self, rendering: Rendering, reference: Tensor, weight: Tensor | None) -> Tensor:
        """Between the rendered normals and the view's own [H, W, 3] (Eq. 9)."""
        normal = unit(rendering.normal) if self.settings.rule.mono_rendered == "unit" else rendering.normal
        error = normal_loss(normal, reference, weight)
        if self.settings.rule.mono_loss == "l1_cos":
            error = error + normal_distance(normal, reference, weight)
        return error


@dataclass(frozen=True)
class StepNumbers:
    """What a training step tells of itself, on the device.

    Attributes:
        names: of the losses.
        gradients: the parameters that had one.
        values: [names + gradients] the losses, and each gradient's largest magnitude.
        maps: what it drew, see `Monitor.last_maps`; another step's as soon as a graph is replayed again.
    """

    names: tuple[str, ...]
    gradients: tuple[str, ...]
    values: Tensor
    maps: Mapping[str, Tensor]

    def losses(self) -> dict[str, Tensor]:
        return dict(zip(self.names, self.values[: len(self.names)].unbind(), strict=True))

    def magnitudes(self) -> tuple[list[str], Tensor]:
        return list(self.gradients), self.values[len(self.names) :]


def lacking_normals(scene: Scene) -> str:
    """What L_mono lacks among the training views, in words; "" where all of them have normals."""
    count, those = len(scene.train), sum(view.normal is not None for view in scene.train)
    if those == count:
        return ""
    if not those:
        return "the data set has no normals for its training views"
    return f"only {those} of {count} training views have normals, and it counts at those alone"


def pruned_ssim_share(beside_noise: float) -> float:
    """Of a set that is pruned, where so much of its views' squared error is not their noise: SSIM would learn that."""
    return beside_noise * PRUNED_SSIM_SHARE + (1 - beside_noise) * SSIM_SHARE


def photometric_loss(image: Tensor, target: Tensor, ssim_share: float = SSIM_SHARE, *, backend: str = "auto") -> Tensor:
    """L_rgb = (1 − s)·mean |I − I_gt| + s·(1 − SSIM), the SSIM by the core's `backend`."""
    difference = (image - target).abs().sum() / image.numel()  # a mean's gradient is a tensor as large as the image
    return torch.lerp(difference, 1 - ssim(image, target, backend=backend), ssim_share)


def eroded(alpha: Tensor) -> Tensor:
    """The least alpha of the 4×4 pixels around each, [H, W]: two before it, itself, and one behind (GaussianShader)."""
    around = functional.pad(1 - alpha[None], (2, 1, 2, 1))  # beyond the border nothing counts: 1 − α ≥ 0
    return 1 - functional.max_pool2d(around, 4, stride=1)[0]


def normal_loss(normal: Tensor, reference: Tensor, weight: Tensor | None = None) -> Tensor:
    """Mean over pixels of 1 − n·N (Eqs. 7 and 9).

    Args:
        normal: [H, W, 3] blended normals as rendered, Σ wᵢnᵢ: where a surface is not opaque they are shorter than 1.
        reference: [H, W, 3] unit normals in the same frame; zero where unknown: such pixels count as no error.
        weight: [H, W] weight of a pixel's error, 1 where None.
    """
    known = reference.detach().any(-1)
    if weight is None:
        return known.mean(dtype=normal.dtype) - (normal * reference).sum() / known.numel()
    return ((known.to(normal) - (normal * reference).sum(-1)) * weight).mean()


def normal_distance(normal: Tensor, reference: Tensor, weight: Tensor | None = None) -> Tensor:
    """Mean over pixels of the L1 distance Σ|n − N|, with `normal_loss`'s arguments.

    Its gradient does not vanish as the angle does, which 1 − cos's does (EnvGS's released code adds both).
    """
    known = reference.detach().any(-1).to(normal)
    error = (normal - reference).abs().sum(-1) * known
    return (error if weight is None else error * weight).mean()


def edge_aware_smoothness(normal: Tensor, image: Tensor) -> Tensor:
    """Mean over pixels of Σ |∂n|·exp(−|∂I|) in both directions, differences of neighboring pixels (Ref-Gaussian).

    Args:
        normal: [H, W, 3] blended normals as rendered.
        image: [H, W, 3] in [0, 1], at whose edges normals may turn; receives no gradient.
    """
    total = normal.new_zeros(())
    for axis in (0, 1):
        turns, edges = (values.diff(dim=axis).abs() for values in (normal, image.detach()))
        if turns.numel():
            total = total + (turns * (-edges).exp()).sum(-1).mean()
    return total


def nearness(depth: Tensor) -> Tensor:
    """clip(1 − normalized depth, 0, 1), [H, W]: 1 at the nearest hits, 0 at the farthest; 1 everywhere on a flat map.

    A weight for the normal losses that spares far surfaces. Depth is normalized to the range of the pixels with a hit,
    without the nearest and the farthest hundredth of them (EnvGS's released code, which takes pixels without one too).
    """
    depth = depth.detach()
    ordered = depth.flatten().sort().values
    misses = (ordered <= 0).sum()
    count = ordered.numel() - misses
    rank = (count // 100).clamp_min(1)
    # By gather, which does not wait for a GPU to say how many hits there are.
    ends = torch.stack([misses + rank - 1, ordered.numel() - rank]).clamp_max(ordered.numel() - 1)
    low, high = ordered.gather(0, ends).unbind()
    weight = (1 - (depth - low) / (high - low).clamp_min(1e-6 * high)).clamp(0, 1)
    return torch.where(count > 0, weight, 1.0)


def training_psnr(image: Tensor, target: Tensor) -> Tensor:
    """−10·log10 of the mean squared error of the clamped image, for progress displays only."""
    return -10 * torch.log10(functional.mse_loss(image.detach().clamp(0, 1), target).clamp_min(1e-12))
