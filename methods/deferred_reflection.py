"""3DGS-DR: 3D Gaussians that reflect a cube map, a ray a pixel (3D Gaussian Splatting with Deferred Reflection).

Its normals are the Gaussians' shortest axes, and nothing but the reflected color teaches them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Rendering, Scene, View
from envgs_bench.parts import BASE, MethodCard

from .envmap import EnvMap, EnvMapSettings
from .gaussians.regions import Ball, foreground_ball
from .settings import PublishedSettings

SCOPE_WEIGHT = 0.4  # of the loss on what reflects outside the ball that may


# PublishedSettings stands first, so that all that every Gaussian method has is as in 3DGS's released code.
@dataclass(frozen=True)
class DeferredReflectionSettings(PublishedSettings, EnvMapSettings):
    """Steps are those of the authors' code, whose runs of 61,000 steps train for 31,000 of them without any event."""

    stretches: bool = False
    longest_run: int = 61_000
    sh_from: int = 10_000

    initial_orientation: str = "world"
    densify_until: int = 30_000
    min_opacity: float = 0.005

    normal_weight: float = 0.0
    mono_weight: float = 0.0
    perceptual_weight: float = 0.0

    initial_beta: float = 1e-3
    beta_lr: float = 6e-3
    beta_threshold: float = 0.0
    beta_reset_from: int = 1
    beta_reset: str = "raise"
    envmap_doublings: int = 0
    envmap_lr: float = 5e-2

    disturb_every: int = 1_000
    disturb_until: int = 24_000
    scope_radius: float = 0.0  # the ball that may reflect, × the cameras' mean distance from its middle; 0: everything


class DeferredReflection(EnvMap):
    """3DGS-DR (Ye et al., SIGGRAPH 2024): 3D Gaussians that reflect a cube map, a ray a pixel.

    A pixel is (1 − r)·c + r·E(d_ref), of maps of color, normal and reflection strength r, which is β here.
    """

    card = MethodCard("3dgs_dr", "3DGS-DR", 60, "#8000E6")
    Settings: ClassVar[type] = DeferredReflectionSettings
    settings: DeferredReflectionSettings
    axes = 3

    def __init__(self, settings: DeferredReflectionSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        self._scope: Ball | None = None

    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        if self.settings.scope_radius > 0:
            around = foreground_ball([view.camera for view in scene.train])
            self._scope = Ball(around.center.to(self.device), self.settings.scope_radius * around.radius)

    def may_reflect(self) -> Tensor:
        means = self.sets[BASE].parameters.tensors["means"].detach()
        if self._scope is None:
            return super().may_reflect()
        return (means - self._scope.center).norm(dim=1) <= self._scope.radius

    def losses(self, rendering: Rendering, target: Tensor, view: View, step: int) -> dict[str, Tensor]:
        """And, once something reflects, the mean r of what lies outside the ball."""
        terms = super().losses(rendering, target, view, step)
        if self._scope is not None and self.reflects:
            outside = ~self.may_reflect()
            strength = self.sets[BASE].parameters.tensors["beta_logits"][:, 0].sigmoid()
            terms["scope"] = SCOPE_WEIGHT * (strength * outside).sum() / outside.sum().clamp_min(1)
        return terms
