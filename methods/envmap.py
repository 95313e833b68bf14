"""The environment-map variant: the reflected color comes from a cube map, as if everything were far away."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Scene, Statistics
from envgs_bench.parts import ENV

from .cubemap import layout_of, resized_cubemap, sample_cubemap
from .parameters import ADAM_EPSILON, optimizer_state, restore_optimizer
from .reflection import ReflectionSettings, ReflectiveMethod

DOUBLES_AT = (7_500, 13_500, 21_000)  # steps of a run of 30,000


@dataclass(frozen=True)
class EnvMapSettings(ReflectionSettings):
    envmap_size: int = 128  # texels along a face's edge (EnvGS paper, App. B.1: 128 and 256)
    envmap_doublings: int = 3  # times that the map's size doubles in training, 0 to 3
    envmap_lr: float = 1e-2  # learning rate of the texels' logits


class EnvMap(ReflectiveMethod):
    """EnvGS "w/ environment map" (paper, Sec. 5.4 and App. B.1): surfels that reflect a cube map, which has no depth.

    Its texels hold logits of colors in [0, 1].

    The map starts with an eighth of its texels an edge and doubles three times, unless told otherwise: a texel that few
    pixels see begins as what its surroundings have learned, and the early map is smooth enough to turn normals by.
    """

    Settings: ClassVar[type] = EnvMapSettings
    settings: EnvMapSettings

    def __init__(self, settings: EnvMapSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        if settings.envmap_size < 2:
            raise ValueError(f"envmap_size is {settings.envmap_size}, expected at least 2")
        if not 0 <= settings.envmap_doublings <= len(DOUBLES_AT):
            raise ValueError(f"envmap_doublings is {settings.envmap_doublings}, expected 0 to {len(DOUBLES_AT)}")
        self._set_texels(torch.zeros(6, settings.envmap_size, settings.envmap_size, 3))

    def start_reflection(self) -> None:
        self._set_texels(torch.zeros(6, 2, 2, 3))  # gray; before_step gives it its size

    def before_step(self, step: int) -> None:
        super().before_step(step)
        size = self._size_at(step)
        if self.reflects and size != self.texels.shape[1]:
            self._set_texels(resized_cubemap(self.texels.detach(), self._layout, size))

    def _size_at(self, step: int) -> int:
        """Texels along a face's edge at a step of the training."""
        doublings = DOUBLES_AT[len(DOUBLES_AT) - self.settings.envmap_doublings :]
        doublings_left = sum(step < self.schedule.at(doubling) for doubling in doublings)
        return max(2, self.settings.envmap_size >> doublings_left)

    def reflected_color(
        self, origins: Tensor, directions: Tensor, step: int | None
    ) -> tuple[Tensor, dict[str, Statistics]]:
        color = sample_cubemap(self.texels, directions.reshape(-1, 3), self._layout).sigmoid()
        return color.reshape(directions.shape), {}

    def model_bytes(self) -> dict[str, int]:
        return super().model_bytes() | {ENV: 4 * self.texels.numel()}

    def other_bytes(self) -> int:
        return 4 * 6 * 3 * self.settings.envmap_size**2

    def _set_texels(self, texels: Tensor) -> None:
        self.texels = texels.detach().to(self.device).requires_grad_()
        self._layout = layout_of(texels.shape[1], self.device)
        self._texel_optimizer = torch.optim.Adam(
            [{"params": [self.texels], "name": "texels"}], lr=self.settings.envmap_lr, eps=ADAM_EPSILON, fused=True
        )

    def optimizers(self) -> list[torch.optim.Optimizer]:
        return [*super().optimizers(), self._texel_optimizer]

    def training_state(self) -> dict[str, Any]:
        texels = {"texels": self.texels}
        moments = optimizer_state(self._texel_optimizer, texels)
        return super().training_state() | {"texels": self.texels.detach(), "texel_moments": moments}

    def resume(self, scene: Scene, steps: int, state: dict[str, Any]) -> None:
        super().resume(scene, steps, state)
        self._set_texels(state["texels"])
        restore_optimizer(self._texel_optimizer, {"texels": self.texels}, state["texel_moments"])

    def state(self) -> dict:
        return super().state() | {"texels": self.texels.detach()}

    def restore(self, state: dict) -> None:
        super().restore(state)
        size = state["texels"].shape[1]
        if size != self.settings.envmap_size:
            raise ValueError(
                f"the checkpoint's cube map has {size} texels an edge, envmap_size is {self.settings.envmap_size}"
            )
        self._set_texels(state["texels"])
