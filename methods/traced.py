"""TracedReflection: reflected rays traced through a set of surfels, EnvGS's own or the base set itself."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Bvh, Rendering, build_bvh, trace

from .reflection import ReflectionSettings, ReflectiveMethod


class TracedReflection(ReflectiveMethod):
    """A reflective method whose reflected color is traced through one of its own sets (paper, Sec. 4.2)."""

    traced: ClassVar[str]  # the set that reflected rays are traced through

    def __init__(self, settings: ReflectionSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        self._bvh: Bvh | None = None

    def prepare(self) -> None:
        super().prepare()
        gaussians = self.prepared.get(self.traced)
        self._bvh = None if gaussians is None else build_bvh(gaussians, backend=self.settings.backend)

    def trace_reflection(self, origins: Tensor, directions: Tensor, step: int | None) -> Rendering:
        """What the rays see of the set `traced`, with `reflected_color`'s arguments, [H, W, …]."""
        return trace(
            self.gaussians(self.traced, step),
            origins,
            directions,
            background=self.background,
            bvh=self._bvh if step is None else None,
            backend=self.settings.backend,
        )
