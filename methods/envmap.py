"""The environment-map variant: the reflected color comes from a cube map, as if everything were far away."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Statistics
from envgs_bench.parts import MethodCard

from .learned_map import MapMethod, MapSettings
from .lighting.cubemap import resized_cubemap, sample_cubemap
from .reflection import ReflectionSettings, ReflectiveMethod

DOUBLES_AT = (7_500, 13_500, 21_000)  # steps of a run of 30,000


@dataclass(frozen=True)
class EnvMapSettings(ReflectionSettings, MapSettings):
    envmap_doublings: int = 3  # times that the map's size doubles in training, 0 to 3


class EnvMap(MapMethod, ReflectiveMethod):
    """EnvGS "w/ environment map" (paper, Sec. 5.4 and App. B.1): surfels that reflect a cube map, which has no depth.

    Its texels hold logits of colors in [0, 1].

    The map starts with an eighth of its texels an edge and doubles three times, unless told otherwise: a texel that few
    pixels see begins as what its surroundings have learned, and the early map is smooth enough to turn normals by.
    """

    card = MethodCard("envmap", "environment map", 30, "#FF9900")
    Settings: ClassVar[type] = EnvMapSettings
    settings: EnvMapSettings
    captured: ClassVar[bool] = True

    def __init__(self, settings: EnvMapSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        if not 0 <= settings.envmap_doublings <= len(DOUBLES_AT):
            raise ValueError(f"envmap_doublings is {settings.envmap_doublings}, expected 0 to {len(DOUBLES_AT)}")

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
        return self._size_before(sum(step < self.schedule.at(doubling) for doubling in doublings))

    def _size_before(self, doublings: int) -> int:
        return max(2, self.settings.envmap_size >> doublings)

    def map_sizes(self) -> set[int]:
        return {self._size_before(doublings) for doublings in range(self.settings.envmap_doublings + 1)}

    def reflected_color(
        self, origins: Tensor, directions: Tensor, step: int | None
    ) -> tuple[Tensor, dict[str, Statistics]]:
        color = sample_cubemap(self.texels, directions.reshape(-1, 3), self._layout).sigmoid()
        return color.reshape(directions.shape), {}
