"""FeatureLight: what a pixel mirrors, made by a small network of a map's features and of the surface's (Ref-GS)."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from envgs_bench.core import Camera, Rendering, Scene
from envgs_bench.core.vectors import unit

from ..gaussians.model import GaussianModel
from ..training.weights import Weights, layer_shapes, network, random_layers
from .latlong import all_levels, looked_up, shape_of
from .settings import FeatureMapSettings
from .shading import mirrored

START, BRIGHTER = 0.25, 0.5  # light that the network shows at first, about: linear; where it attenuates, as shown
MOST_LOG = 5.0  # of its logarithm
FEATURES = 4  # of a surface, and of the map where they stand side by side
CROSSED = 16  # features of the map where each is multiplied by each of the surface
LEAST_ALPHA = 0.05  # below which a pixel's material counts as that of a fainter one


class FeatureLight(Weights):
    """The map, the network, and the color that they make.

    Args:
        crossed: whether features of map and surface are multiplied (Ref-GS), or stand side by side (Ref-DGS).
        attenuates: whether it says of a surface how much of its own color is left, too (RT-Splatting).

    Attributes:
        begun: whether anything is mirrored; follows the first steps of a training.
    """

    def __init__(
        self, model: GaussianModel, settings: FeatureMapSettings, crossed: bool = True, attenuates: bool = False
    ) -> None:
        self.begun = False
        self._model, self._settings = model, settings
        self._of_images: Tensor | None = None
        self._crossed, self._attenuates = crossed, attenuates
        channels = CROSSED if crossed else FEATURES
        known, neurons = (80, 256) if crossed else (10, 64)
        self._sizes = (known, *[neurons] * settings.rule.hidden_layers, 3 + attenuates)
        shapes = {"map": (*shape_of(settings.map_levels), channels), **layer_shapes(self._sizes)}
        rates = {name: settings.map_lr if name == "map" else settings.network_lr for name in shapes}
        super().__init__(shapes, rates, model.device)

    def start(self, scene: Scene) -> None:
        self.begun = False
        values = random_layers(self._sizes, self._model.generator)
        values[f"layer{len(self._sizes) - 2}_bias"] = self._first_logs()
        self.become({"map": torch.zeros_like(self.tensors["map"]), **values})

    def _first_logs(self) -> Tensor:
        if not self._attenuates:
            return torch.full((3,), math.log(START))
        return torch.tensor([math.log(BRIGHTER)] * 3 + [0.0])

    def begin_step(self, step: int) -> None:
        self.begun = step > self._model.schedule.at(self._settings.warm_up)

    def phase(self, step: int) -> Hashable:
        return self.begun

    def prepare(self) -> None:
        self._of_images = all_levels(self.tensors["map"].detach())

    def seen(self, base: Rendering, camera: Camera, step: int | None, roughness: Tensor, features: Tensor) -> Tensor:
        """Light [H, W, 3] that surfaces mirror, with `told`'s arguments."""
        return self.told(base, camera, step, roughness, features)[..., :3].clamp_max(MOST_LOG).exp()

    def told(self, base: Rendering, camera: Camera, step: int | None, roughness: Tensor, features: Tensor) -> Tensor:
        """What the network says of each pixel, [H, W, 3] or 4: logarithms of light, and a logit of what is left.

        Differentiable in all that it is made of.

        Args:
            base: whose normals mirror.
            step: the training's; None for an image.
            roughness: [H, W, 1] in [0, 1].
            features: [H, W, FEATURES] of the surface, or of what is mirrored near it.
        """
        shape = roughness.shape[:2]
        directions, cosine = mirrored(unit(camera.rays()[1]), unit(base.normal))
        levels = self._of_images if step is None else all_levels(self.tensors["map"])
        assert levels is not None
        rough, own = roughness.reshape(-1), features.reshape(-1, FEATURES)
        far = looked_up(levels, directions.reshape(-1, 3), rough, self._settings.map_levels)
        if self._crossed:
            crossed = (unit(own)[:, :, None] * far[:, None]).flatten(1)
            known: Sequence[Tensor] = (crossed, far)
        else:
            known = (far, own, rough[:, None], cosine.reshape(-1, 1))
        return network(self.tensors, torch.cat([*known], dim=1)).reshape(*shape, -1)

    def training_state(self) -> dict[str, Any]:
        return super().training_state() | {"begun": self.begun}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        super().restore_training(state)
        self.begun = state["begun"]

    def state(self) -> dict[str, Any]:
        return super().state() | {"reflects": self.begun}

    def restore(self, state: Mapping[str, Any]) -> None:
        super().restore(state)
        self.begun = state["reflects"]
