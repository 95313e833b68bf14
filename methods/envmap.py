"""The environment-map variant: the reflected color comes from a cube map, as if everything were far away."""

from __future__ import annotations

from typing import ClassVar

import torch

from envgs_bench.core import Scene
from envgs_bench.parts import BASE, MethodCard

from .gaussian_method import GaussianMethod
from .gaussians.policy import SetPolicy
from .lighting.disturbance import Disturbance, reflecting_policy
from .lighting.light_map import CubeMap
from .lighting.reflection import Reflection
from .lighting.settings import EnvMapSettings
from .training.schedule import Schedule


class EnvMap(GaussianMethod):
    """EnvGS "w/ environment map" (paper, Sec. 5.4 and App. B.1): surfels that reflect a cube map, without depth."""

    card = MethodCard("envmap", "environment map", 30, "#FF9900")
    Settings: ClassVar[type] = EnvMapSettings
    settings: EnvMapSettings
    axes = 2
    cuda_graph: ClassVar[bool] = True

    def __init__(self, settings: EnvMapSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        light = CubeMap(self.model, settings, settings.envmap_doublings)
        self.reflection = Reflection(self.model, settings, light)
        self.parts = {"reflection": self.reflection, "disturbance": Disturbance(self.model, settings)}

    def policies(self, schedule: Schedule, scene: Scene | None) -> dict[str, SetPolicy]:
        return {BASE: reflecting_policy(self.settings, schedule, scene)}
