"""Ref-GS and Ref-DGS: surfels whose pixels mirror a map of features, and features of what is near; no ray is traced.

A pixel's linear light is its albedo and what a small network makes of the map along the mirrored ray, looked up by
roughness. Ref-GS tells surfaces apart by features of their own. Ref-DGS rasterizes a second set of surfels in their
place, which holds what is reflected nearby.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, GaussianSet, Rendering, Scene, Statistics, View
from envgs_bench.parts import BASE, ENV, REFLECTION, MethodCard

from .gaussian_method import GaussianMethod
from .gaussians.model import GaussianModel
from .gaussians.parameters import SH_DC
from .gaussians.policy import INITIAL_OPACITY, SetPolicy, Start, opacity_resets, zeros
from .gaussians.regions import Scope
from .lighting.feature_light import FEATURES, LEAST_ALPHA, FeatureLight
from .lighting.settings import RefGSSettings
from .lighting.shading import to_linear, to_srgb
from .training.losses import photometric_loss
from .training.schedule import RECOVERY, Part, Schedule

ALBEDO_UNIT, MOST_LOG = 5.0, 5.0  # an albedo is exp(x) ÷ the one, x at most the other
DARK = -2.0  # x at first where spherical harmonics are learned before
NEAR_SCALE = 0.1**0.5  # × the distance to its neighbors, that a surfel of the near set starts with
PLAIN, OUTSIDE = "plain", "outside"  # what losses read of a picture: its SH [H, W, 3], and their weight [H, W, 1]
SURFACE = {"albedo_logs": 3, "roughness_logits": 1}  # fields of a surfel, and their columns
FEATURE = {"feature_logits": FEATURES}  # of Ref-GS's surfels, and of the near set's; tanh x is 2·sigmoid(2x) − 1


class RefGS(GaussianMethod):
    """Ref-GS (Zhang et al., CVPR 2025), and with `near_set` Ref-DGS (SIGGRAPH 2026)."""

    card = MethodCard("ref_gs", "Ref-GS", 100, "#889999")
    Settings: ClassVar[type] = RefGSSettings
    settings: RefGSSettings
    axes = 2
    cuda_graph: ClassVar[bool] = True

    def __init__(self, settings: RefGSSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        self.light = FeatureLight(self.model, settings, crossed=not settings.near_set)
        self.surfaces = Surfaces(self.model, settings)
        self.model.shade = self.surfaces.shaded
        self.parts = {"light": self.light, "surfaces": self.surfaces}

    def policies(self, schedule: Schedule, scene: Scene | None) -> dict[str, SetPolicy]:
        s, scale = self.settings, schedule.rate_scale
        columns = SURFACE if s.near_set else SURFACE | FEATURE
        rates = {"albedo_logs": s.albedo_lr * scale, "roughness_logits": s.feature_lr * scale}
        rates |= {"feature_logits": s.feature_lr * scale}
        base = super().policies(schedule, scene)[BASE]
        base = base.with_materials(partial(zeros, columns), columns, rates)
        base = replace(base, sh_degree=base.sh_degree if s.scope_radius else 0)
        return {BASE: base} | ({ENV: self._near_policy(base, scene)} if s.near_set else {})

    def _near_policy(self, base: SetPolicy, scene: Scene | None) -> SetPolicy:
        """The base's, but for what starts it and makes it grow: as soon as the base, by the published rules."""
        rule = self.settings.rule
        orientation = "positive" if rule.initial_orientation == "positive" else "random"
        start = Start(INITIAL_OPACITY, orientation, None, partial(zeros, FEATURE), FEATURE, NEAR_SCALE)
        young = base.schedule.at(self.settings.warm_up) + (0 if rule.growth == "gradient" else RECOVERY)
        grown = replace(base, growth="gradient", resets=opacity_resets(self.settings, base.schedule, scene))
        return replace(grown, name=ENV, start=start, sh_degree=0, young_until=young)

    def draw(self, camera: Camera, step: int | None) -> tuple[Rendering, dict[str, Statistics]]:
        base = self.model.rasterize(camera, step)
        statistics = {BASE: base.statistics}
        if self.settings.rule.shown_first == "sh" and not self.light.begun:
            return replace(base, layers={BASE: base.color, REFLECTION: torch.zeros_like(base.color)}), statistics
        alpha = base.alpha[..., None]
        behind = (1 - alpha) * self.model.background
        weight, material, plain = alpha, base.extras / alpha.clamp_min(LEAST_ALPHA), base.color
        if given := self.settings.rule.mirror_alpha == "given":
            weight, material = alpha.detach(), base.extras
            plain = weight * (base.color - behind) + behind
        roughness, albedo, *own = material.split([1, 3, *_rest(base)], dim=-1)
        mirrored = torch.zeros_like(albedo)
        if self.light.begun:
            if ENV in self.model.sets:
                near = self.model.rasterize(camera, step, self.surfaces.near(step))
                statistics[ENV] = near.statistics
                own = [near.extras]
            mirrored = self.light.seen(base, camera, step, roughness, own[0])
        light = albedo + mirrored
        inside = self.surfaces.scope.inside(base, camera)
        outside, through = alpha.detach() * ~inside, behind
        if self.settings.rule.plain_share == "rest":
            plain, outside = base.color, 1 - alpha.detach() * inside
            through = behind + (1 - weight) * (base.color - behind)
        shown = weight * to_srgb(light.clamp_max(1) if given else light) + through
        diffuse = weight * to_srgb(albedo) + through
        layers = {BASE: torch.where(inside, diffuse, plain), REFLECTION: to_srgb(mirrored) * inside * weight}
        if step is not None:
            layers |= {PLAIN: base.color, OUTSIDE: outside}
        return replace(base, color=torch.where(inside, shown, plain), layers=layers), statistics

    def losses(self, rendering: Rendering, target: Tensor, view: View, step: int) -> dict[str, Tensor]:
        """And, once anything mirrors, by the rules: what does not, by itself, and the entropy of opacities."""
        terms, rule = super().losses(rendering, target, view, step), self.settings.rule
        if not self.light.begun:
            return terms
        if rule.plain_again and (self.settings.scope_radius or rule.plain_share == "rest"):
            plain, outside = rendering.layers[PLAIN], rendering.layers[OUTSIDE]
            terms["plain"] = photometric_loss(plain * outside, target * outside, backend=self.settings.backend)
        if rule.opacity_entropy:
            terms["entropy"] = rule.opacity_entropy * self.surfaces.entropy(view.camera)
        return terms


class Surfaces(Part):
    """What surfels show of themselves, where a ball lets them mirror, and the near set's beginning."""

    def __init__(self, model: GaussianModel, settings: RefGSSettings) -> None:
        self._model, self._settings = model, settings
        self.scope = Scope(settings.scope_radius, model.device)

    @torch.no_grad()
    def start(self, scene: Scene) -> None:
        """Albedos begin dark, or as the points' colors; the near set lies at the points, too."""
        s, parameters = self._settings, self._model.sets[BASE].parameters
        colors = 0.5 + SH_DC * parameters.tensors["sh_dc"].detach()[:, 0]
        logs = (ALBEDO_UNIT * to_linear(colors)).clamp_min(1e-3).log()
        parameters.replace("albedo_logs", torch.full_like(logs, DARK) if s.rule.shown_first == "sh" else logs)
        self.scope.start(scene)
        if s.near_set:
            self._model.sets[ENV] = self._model.new_set(ENV, scene.points, torch.full_like(scene.points, 0.5))

    def entropy(self, camera: Camera) -> Tensor:
        """Mean entropy of the opacities that a camera has in view, in nats, scalar."""
        logits = self._model.sets[BASE].parameters.tensors["opacity_logits"]
        entropies = functional.softplus(logits) - logits * logits.sigmoid()
        return self._model.mean_in_view(entropies, camera)

    def shaded(self, gaussians: GaussianSet, camera: Camera, step: int | None) -> GaussianSet:
        """With roughness, albedo and, in Ref-GS, features as extras, [N, 4] or [N, 8]."""
        tensors = self._model.sets[BASE].parameters.tensors
        albedo = tensors["albedo_logs"].clamp_max(MOST_LOG).exp() / ALBEDO_UNIT
        known = [tensors["roughness_logits"].sigmoid(), albedo]
        if "feature_logits" in tensors:
            known.append(tensors["feature_logits"].tanh())
        return replace(gaussians, extras=torch.cat(known, dim=1))

    def near(self, step: int | None) -> GaussianSet:
        """The near set, with its features as extras."""
        features = self._model.sets[ENV].parameters.tensors["feature_logits"].tanh()
        return replace(self._model.gaussians(ENV, step), extras=features)

    def state(self) -> dict[str, Any]:
        return self.scope.state()

    def restore(self, state: Mapping[str, Any]) -> None:
        self.scope.restore(state)


def _rest(base: Rendering) -> list[int]:
    """The columns behind roughness and albedo, where there are any."""
    return [rest] if (rest := base.extras.shape[-1] - 4) else []
