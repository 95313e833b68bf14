"""MapMethod: what methods share that learn a cube map of the surroundings, however they look it up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from envgs_bench.core import Scene
from envgs_bench.parts import ENV

from .gaussian_method import GaussianMethod
from .lighting.cubemap import layout_of
from .settings import GaussianSettings
from .training.optimizer import adam, optimizer_state, restore_optimizer


@dataclass(frozen=True)
class MapSettings(GaussianSettings):
    envmap_size: int = 128  # texels along a face's edge (EnvGS paper, App. B.1: 128 and 256)
    envmap_lr: float = 1e-2  # learning rate of the texels' logits


class MapMethod(GaussianMethod):
    """A Gaussian method with a cube map, whose optimizer, bytes and state it adds to the sets'.

    Attributes:
        texels: [6, S, S, 3] logits of colors in [0, 1].
    """

    Settings: ClassVar[type] = MapSettings
    settings: MapSettings

    def __init__(self, settings: MapSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        if settings.envmap_size < 2:
            raise ValueError(f"envmap_size is {settings.envmap_size}, expected at least 2")
        self._set_texels(torch.zeros(6, settings.envmap_size, settings.envmap_size, 3))

    def model_bytes(self) -> dict[str, int]:
        return super().model_bytes() | {ENV: 4 * self.texels.numel()}

    def other_bytes(self) -> int:
        return 4 * 6 * 3 * self.settings.envmap_size**2

    def _set_texels(self, texels: Tensor) -> None:
        self.texels = texels.detach().to(self.device).requires_grad_()
        self._layout = layout_of(texels.shape[1], self.device)
        self._texel_optimizer = adam([{"params": [self.texels], "lr": self.settings.envmap_lr, "name": "texels"}])

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
        if size not in self.map_sizes():
            known = " or ".join(map(str, sorted(self.map_sizes())))
            raise ValueError(
                f"the checkpoint's cube map has {size} texels an edge, expected {known}: "
                f"envmap_size is {self.settings.envmap_size}"
            )
        self._set_texels(state["texels"])

    def map_sizes(self) -> set[int]:
        """Texels along a face's edge that the map may have at some step of a training."""
        return {self.settings.envmap_size}
