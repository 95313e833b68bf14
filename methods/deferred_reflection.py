"""3DGS-DR: 3D Gaussians that reflect a cube map, a ray a pixel (3D Gaussian Splatting with Deferred Reflection).

Its normals are the Gaussians' shortest axes, and nothing but the reflected color teaches them.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Rendering, Scene, View
from envgs_bench.parts import BASE, MethodCard

from .gaussian_method import GaussianMethod
from .gaussians.policy import SetPolicy
from .gaussians.regions import Ball, foreground_ball
from .lighting.disturbance import Disturbance, reflecting_policy
from .lighting.light_map import CubeMap
from .lighting.reflection import Reflection
from .lighting.settings import DeferredReflectionSettings
from .training.schedule import Schedule

SCOPE_WEIGHT = 0.4  # of the loss on what reflects outside the ball that may


class DeferredReflection(GaussianMethod):
    """3DGS-DR (Ye et al., SIGGRAPH 2024): 3D Gaussians that reflect a cube map, a ray a pixel.

    A pixel is (1 − r)·c + r·E(d_ref), of maps of color, normal and reflection strength r, which is β here.
    """

    card = MethodCard("3dgs_dr", "3DGS-DR", 60, "#8000E6")
    Settings: ClassVar[type] = DeferredReflectionSettings
    settings: DeferredReflectionSettings
    axes = 3
    cuda_graph: ClassVar[bool] = True

    def __init__(self, settings: DeferredReflectionSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        light = CubeMap(self.model, settings, settings.envmap_doublings)
        disturbance = Disturbance(self.model, settings)
        if settings.scope_radius > 0:
            disturbance.may_reflect = self._in_scope
        self.reflection = Reflection(self.model, settings, light)
        self.parts = {"reflection": self.reflection, "disturbance": disturbance}
        self._scope = Ball(torch.zeros(3, device=self.device), 0.0)

    def policies(self, schedule: Schedule, scene: Scene | None) -> dict[str, SetPolicy]:
        return {BASE: reflecting_policy(self.settings, schedule, scene)}

    def initialize(self, scene: Scene, steps: int) -> None:
        super().initialize(scene, steps)
        if self.settings.scope_radius == 0:
            return
        around = foreground_ball([view.camera for view in scene.train])
        self._scope = Ball(around.center.to(self.device), self.settings.scope_radius * around.radius)

    def _in_scope(self) -> Tensor:
        """What may reflect, [N] of the base set: what lies in the ball."""
        means = self.model.sets[BASE].parameters.tensors["means"].detach()
        return (means - self._scope.center).norm(dim=1) <= self._scope.radius

    def losses(self, rendering: Rendering, target: Tensor, view: View, step: int) -> dict[str, Tensor]:
        """And, once something reflects, the mean r of what lies outside the ball."""
        terms = super().losses(rendering, target, view, step)
        if self.settings.scope_radius > 0 and self.reflection is not None and self.reflection.begun:
            outside = ~self._in_scope()
            strength = self.model.sets[BASE].parameters.tensors["beta_logits"][:, 0].sigmoid()
            terms["scope"] = SCOPE_WEIGHT * (strength * outside).sum() / outside.sum().clamp_min(1)
        return terms
