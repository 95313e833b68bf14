"""TracedReflection: reflected rays traced through a set of surfels, EnvGS's own or the base set itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Bvh, Statistics, build_bvh, trace, trace_color
from envgs_bench.core.trace import SH_DIRECTIONS

from .reflection import ReflectionSettings, ReflectiveMethod
from .settings import check_words


@dataclass(frozen=True)
class TracedSettings(ReflectionSettings):
    traced_sh_direction: str = "center"  # a traced primitive's color is seen toward its center, or along the ray: ray
    traced_near: float = 0.0  # hits nearer to a reflected ray's start are not drawn, world units
    traced_background: str = "scene"  # what reflected rays that pass everything see: the scene's background, or black


class TracedReflection(ReflectiveMethod):
    """A reflective method whose reflected color is traced through one of its own sets (paper, Sec. 4.2)."""

    Settings: ClassVar[type] = TracedSettings
    settings: TracedSettings
    traced: ClassVar[str]  # the set that reflected rays are traced through

    def __init__(self, settings: TracedSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        check_words(settings, {"traced_sh_direction": SH_DIRECTIONS, "traced_background": ("scene", "black")})
        self._bvh: Bvh | None = None

    def prepare(self) -> None:
        super().prepare()
        gaussians = self.prepared.get(self.traced)
        self._bvh = None if gaussians is None else build_bvh(gaussians, backend=self.settings.backend)

    def reflected_color(
        self, origins: Tensor, directions: Tensor, step: int | None
    ) -> tuple[Tensor, dict[str, Statistics]]:
        """What the rays see of the set `traced`; without statistics of an image for which no gradients are recorded."""
        arguments: dict[str, Any] = {
            "background": self.background if self.settings.traced_background == "scene" else None,
            "t_min": self.settings.traced_near,
            "sh_direction": self.settings.traced_sh_direction,
            "bvh": self._bvh if step is None else None,
            "backend": self.settings.backend,
        }
        gaussians = self.gaussians(self.traced, step)
        if step is None and not torch.is_grad_enabled():
            return trace_color(gaussians, origins, directions, **arguments)[0], {}
        rendering = trace(gaussians, origins, directions, **arguments)
        return rendering.color, {self.traced: rendering.statistics}
