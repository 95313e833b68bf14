"""RT-Splatting: surfels that stop light as a surface does, and hide what lies behind them as much as glass does.

Each surfel has an occupancy σ, by which surfaces are drawn, and an opacity α, by which it hides what lies behind. A
pixel is ρ·C_spec + a·(τ·C_tran + (1 − τ)·C_scat). C_tran are the colors blended by σ·α, C_scat those blended by σ. Its
surface transmits τ and reflects ρ. C_spec and the attenuation a are what a network makes of Ref-GS's map.

Published, it learns C_tran alone at first. Where normals count before anything mirrors, a pixel is then
τ·C_tran + (1 − τ)·C_scat, as all images are that are drawn in this time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, GaussianSet, Rendering, Scene, Statistics, View
from envgs_bench.core.torch.rotation import rotation_matrices
from envgs_bench.parts import BASE, REFLECTION, TRANSMISSIVE, MethodCard

from .gaussian_method import GaussianMethod
from .gaussians.policy import SetPolicy, zeros
from .gaussians.regions import Scope
from .gaussians.trained_set import RESET_OPACITY
from .lighting.feature_light import FEATURES, MOST_LOG, FeatureLight
from .lighting.settings import RTSplattingSettings
from .training.losses import MAY_MIRROR
from .training.schedule import RESET_FLOOR, Every, Part, Schedule, falls_on

GATE = 4.0  # × how much what is mirrored varies around a pixel: how soon what lies behind learns nothing there
SURFACE = {  # fields of a surfel, and their columns; logits, 0 at first
    "roughness_logits": 1,
    "feature_logits": FEATURES,
    "reflectance_logits": 1,
    "hiding_logits": 1,
    "transmission_logits": 1,
}
LEARNED = ("surface_opacity", "transmission", "scattered")  # what losses read of a picture: α, τ [H, W], C_scat


class RTSplatting(GaussianMethod):
    """RT-Splatting (CVPR 2026). Transparency masks are an input: the region `transmissive` of the training views."""

    card = MethodCard("ref_gs", "RT-Splatting", 104, "#889999")  # whose map it has
    Settings: ClassVar[type] = RTSplattingSettings
    settings: RTSplattingSettings
    axes = 2

    def __init__(self, settings: RTSplattingSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        self.light = FeatureLight(self.model, settings, attenuates=True)
        self.panes = Panes(self, settings)
        self.parts = {"light": self.light, "panes": self.panes}

    def policies(self, schedule: Schedule, scene: Scene | None) -> dict[str, SetPolicy]:
        s, scale = self.settings, schedule.rate_scale
        rates = {
            "roughness_logits": s.feature_lr * scale,
            "feature_logits": s.feature_lr * scale,
            "reflectance_logits": s.reflectance_lr * scale,
            "hiding_logits": s.opacity_lr,
            "transmission_logits": s.transmission_lr * scale,
        }
        base = super().policies(schedule, scene)[BASE]
        return {BASE: base.with_materials(partial(zeros, SURFACE), SURFACE, rates)}

    def draw(self, camera: Camera, step: int | None) -> tuple[Rendering, dict[str, Statistics]]:
        gaussians = self.model.gaussians(BASE, step)
        if step is not None and not self.light.begun and not self.runner.loss.began(step)[0]:
            behind = self.model.rasterize(camera, step, self.panes.volume(gaussians))
            layers = {BASE: behind.color, REFLECTION: torch.zeros_like(behind.color)}
            return replace(behind, layers=layers), {BASE: behind.statistics}
        base = self.model.rasterize(camera, step, self.panes.surface(gaussians))
        volume = self.model.rasterize(camera, step, self.panes.volume(gaussians))
        statistics = [base.statistics, volume.statistics]
        if self.settings.rule.normal_side == "own":
            sides = self.model.rasterize(camera, step, self.panes.sides(gaussians))
            base = replace(base, normal=sides.extras)
            statistics.append(sides.statistics)
        roughness, features, reflectance, opacity, transmission = base.extras.split([1, FEATURES, 1, 1, 1], dim=-1)
        inside = self.panes.inside(base, camera)
        reflectance, transmission = reflectance * inside, transmission * inside
        mirrors = inside * base.alpha[..., None].detach()
        if self.light.begun:
            told = self.light.told(base, camera, step, roughness, features)
            specular = told[..., :3].clamp_max(MOST_LOG).exp() * reflectance
            kept = 1 - told[..., 3:].neg().sigmoid() * mirrors
            transmitted = kept * transmission * volume.color
            if step is not None:
                transmitted = gated(transmitted, specular, 1 - opacity)
            diffuse = transmitted + kept * (1 - transmission) * base.color
        else:
            specular = torch.zeros_like(base.color)
            diffuse = transmission * volume.color + (1 - transmission) * base.color
        layers = {BASE: diffuse, REFLECTION: specular}
        if step is not None:
            layers |= dict(zip(LEARNED, (opacity[..., 0], transmission[..., 0], base.color), strict=True))
            layers[MAY_MIRROR] = mirrors[..., 0]
        return replace(base, color=diffuse + specular, layers=layers), {BASE: AllPasses(*statistics)}


class AllPasses(Statistics):
    """What passes over the same primitives learned: the sum of gradients, and the larger of the first two's weights.

    Args:
        passes: of surfaces, of what lies behind, and others with the weights of either.
    """

    def __init__(self, *passes: Statistics) -> None:
        self.weights = torch.maximum(passes[0].weights, passes[1].weights)
        self._passes = passes

    @property
    def position_gradients(self) -> Tensor | None:  # type: ignore[override]
        known = [gradients for each in self._passes if (gradients := each.position_gradients) is not None]
        return sum(known[1:], start=known[0]) if known else None


class Panes(Part):
    """What surfels let through, and what masks of the transparent teach them."""

    def __init__(self, method: RTSplatting, settings: RTSplattingSettings) -> None:
        self._model, self._settings, self._light = method.model, settings, method.light
        self._scope = Scope(settings.scope_radius, method.device)
        self._masks: dict[str, Tensor] = {}

    @property
    def _tensors(self) -> dict[str, Tensor]:
        return self._model.sets[BASE].parameters.tensors

    @torch.no_grad()
    def start(self, scene: Scene) -> None:
        self._scope.start(scene)
        known = any(TRANSMISSIVE in view.masks for view in scene.train)
        masks = {view.name: view.masks.get(TRANSMISSIVE, torch.zeros_like(view.image[..., 0])) for view in scene.train}
        self._masks = {name: mask.to(self._model.device).float() for name, mask in masks.items()} if known else {}

    def surface(self, gaussians: GaussianSet) -> GaussianSet:
        """Drawn by occupancy, with roughness, features, ρ, α and τ as extras, [N, 8]."""
        known = [self._tensors[name] for name in SURFACE]
        values = [
            each.tanh() if name == "feature_logits" else each.sigmoid()
            for name, each in zip(SURFACE, known, strict=True)
        ]
        return replace(gaussians, extras=torch.cat(values, dim=1))

    def sides(self, gaussians: GaussianSet) -> GaussianSet:
        """Drawn by occupancy, with normals on the side that surfels have as extras, [N, 3]; colors are not used."""
        normals = rotation_matrices(gaussians.quaternions)[:, :, 2]
        return replace(gaussians, sh=gaussians.sh[:, :1].detach(), extras=normals)

    def volume(self, gaussians: GaussianSet) -> GaussianSet:
        """Drawn by occupancy × opacity."""
        return replace(gaussians, opacities=gaussians.opacities * self._tensors["hiding_logits"][:, 0].sigmoid())

    def inside(self, base: Rendering, camera: Camera) -> Tensor:
        return self._scope.inside(base, camera)

    def losses(self, rendering: Rendering, view: View, step: int) -> dict[str, Tensor]:
        """Occupancy's decay; and by masks, that glass hides nothing and is alike, and that nothing else transmits.

        Weighted, and nothing before anything mirrors.

        Args:
            rendering: of a training step, with α, τ and C_scat of the surfaces [H, W, …] among its layers.
        """
        if not self._light.begun:
            return {}
        s = self._settings
        opacity, transmission, scattered = (rendering.layers[name] for name in LEARNED)
        terms = {"occupancy": s.occupancy_weight * self._mean_occupancy(view.camera)}
        if view.name in self._masks:
            mask = self._masks[view.name]
            terms["transparent"] = s.mask_weight * cross_entropy(1 - opacity, mask)
            opaque = -(1 - transmission).clamp_min(1e-6).log() * (1 - mask)
            terms["transmission"] = s.mask_weight * opaque.sum() / (1 - mask).sum().clamp_min(1)
            if s.mask_weight > 0 and s.rule.glass_alike > 0:
                unlike = spread(transmission[..., None], mask).sum() + spread(scattered, mask).mean()
                terms["glass"] = s.rule.glass_alike * unlike
        return terms

    def _mean_occupancy(self, camera: Camera) -> Tensor:
        """Of all surfels, or by the rules of those that a camera has in view, scalar."""
        shares = self._tensors["opacity_logits"].sigmoid()
        of_all = self._settings.rule.occupancy_of == "all"
        return shares.mean() if of_all else self._model.mean_in_view(shares, camera)

    # Its resets

    def events(self) -> Sequence[Every]:
        schedule, s = self._model.schedule, self._settings
        every = schedule.interval(s.opacity_reset_every, RESET_FLOOR)
        until = schedule.at(s.densify_until)
        return [
            Every(
                "reset_hiding",
                self.reset,
                also=lambda step: every < step < until and falls_on(2 * step, every) and not falls_on(step, every),
                recovery=RESET_FLOOR,
            )
        ]

    @torch.no_grad()
    def reset(self, step: int) -> None:
        """Opacities fall half-way between two resets of occupancy."""
        parameters = self._model.sets[BASE].parameters
        lowest = torch.tensor(RESET_OPACITY).logit()
        parameters.replace("hiding_logits", parameters.tensors["hiding_logits"].detach().clamp_max(float(lowest)))

    def state(self) -> dict[str, Any]:
        return self._scope.state()

    def restore(self, state: Mapping[str, Any]) -> None:
        self._scope.restore(state)


def gated(behind: Tensor, specular: Tensor, weights: Tensor) -> Tensor:
    """`behind` [H, W, 3], with × exp(−GATE·s) its gradient, where s is how much what is mirrored varies around a pixel.

    s² = mean(w·x²) − mean(w·x)² / mean(w) over 3×3 pixels of each color.

    Args:
        specular: x, [H, W, 3].
        weights: w, [H, W, 1].
    """
    with torch.no_grad():
        total = _around(weights).clamp_min(1e-12)
        squares = _around(weights * specular.square()) - _around(weights * specular).square() / total
        share = (-GATE * squares.clamp_min(0).sqrt()).exp()
    return share * behind + (1 - share) * behind.detach()


def cross_entropy(share: Tensor, truth: Tensor) -> Tensor:
    """Mean −log of the probability that shares [H, W] give to truths [H, W] of 0 and 1."""
    return functional.binary_cross_entropy(share.clamp(1e-6, 1 - 1e-6), truth)


def spread(values: Tensor, mask: Tensor) -> Tensor:
    """Σ over a mask [H, W] of 0 and 1 of the squared distance of values [H, W, C] from their mean there, [C]."""
    weights = mask[..., None]
    mean = (values * weights).sum((0, 1)) / weights.sum().clamp_min(1)
    return ((values - mean).square() * weights).sum((0, 1))


def _around(values: Tensor) -> Tensor:
    """The mean over 3×3 pixels, mirrored at the edges, [H, W, C]."""
    padded = functional.pad(values.movedim(-1, 0)[None], (1, 1, 1, 1), mode="reflect")
    return functional.avg_pool2d(padded, 3, stride=1)[0].movedim(0, -1)
