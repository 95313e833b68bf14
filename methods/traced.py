"""TracedReflection: reflected rays that meet a set of surfels, EnvGS's own or the base set itself."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Bvh, Camera, Rendering, build_bvh, trace
from envgs_bench.core.cuda import reflect

from .reflection import MIN_ALPHA, ReflectionSettings, ReflectiveMethod


class TracedReflection(ReflectiveMethod):
    """A reflective method whose reflected colour is traced through one of its own sets (paper, Sec. 4.2)."""

    traced: ClassVar[str]  # the set that reflected rays meet

    def __init__(self, settings: ReflectionSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        self._bvh: Bvh | None = None

    def prepare(self) -> None:
        super().prepare()
        gaussians = self._prepared.get(self.traced)
        self._bvh = None if gaussians is None else build_bvh(gaussians, backend=self.settings.backend)

    def _reflection(self, base: Rendering, camera: Camera, step: int | None) -> tuple[Tensor, Tensor, dict]:
        if step is not None or not base.alpha.is_cuda or self.settings.backend == "torch":
            return super()._reflection(base, camera, step)
        # An image on the GPU: every pixel's ray is traced, those that do not reflect at no cost, since to count those
        # that do the host would have to wait.
        origins, directions, beta = reflect(
            base,
            camera,
            offset=self.settings.ray_offset * self.radius,
            alpha_min=MIN_ALPHA,
            beta_min=self._least_beta(base.extras),
        )
        color, statistics = self._reflected_color(origins, directions, step)
        return color, beta[..., None], statistics

    def _trace(self, origins: Tensor, directions: Tensor, step: int | None) -> Rendering:
        return trace(
            self._gaussians(self.traced, step),
            origins,
            directions,
            background=self.background,
            bvh=self._bvh if step is None else None,
            backend=self.settings.backend,
        )
