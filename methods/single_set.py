"""One set of surfels for the scene and for what it reflects: the design that the paper's App. B.3 decides against."""

from __future__ import annotations

from typing import ClassVar

import torch

from envgs_bench.core import Scene
from envgs_bench.parts import BASE, MethodCard

from .gaussian_method import GaussianMethod
from .gaussians.policy import SetPolicy
from .lighting.disturbance import Disturbance, reflecting_policy
from .lighting.light_map import far_map
from .lighting.reflection import Reflection, Traced
from .lighting.settings import ReflectionSettings
from .training.schedule import Schedule


class SingleSet(GaussianMethod):
    """EnvGS without environment Gaussians: reflected rays are traced through the base set (paper, App. B.3).

    A wrong reflected ray then pulls at the scene's own geometry, which sends it elsewhere; the paper reports that this
    does not converge. Densification uses the statistics of the picture's own pass only.
    """

    card = MethodCard("envgs_single_set", "EnvGS, one set", 50, "#66001A")
    Settings: ClassVar[type] = ReflectionSettings
    settings: ReflectionSettings
    axes = 2
    cuda_graph: ClassVar[bool] = True

    def __init__(self, settings: ReflectionSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        light = Traced(self.model, settings, BASE)
        self.reflection = Reflection(self.model, settings, light)
        self.parts = {"reflection": self.reflection, "disturbance": Disturbance(self.model, settings)}
        self.parts |= far_map(self.model, settings, light)

    def policies(self, schedule: Schedule, scene: Scene | None) -> dict[str, SetPolicy]:
        return {BASE: reflecting_policy(self.settings, schedule, scene)}
