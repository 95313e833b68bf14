"""CubeMap: a learned map of the surroundings, as if everything were far away; Filtered: the same for any roughness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from envgs_bench.core import Scene, Statistics
from envgs_bench.parts import ENV

from ..gaussians.model import GaussianModel
from ..training.optimizer import adam, optimizer_state, restore_optimizer
from ..training.schedule import Part
from .cubemap import layout_of, resized_cubemap, sample_cubemap
from .prefiltered_cubemap import RoughMap, prefilter_of, rough_map
from .reflection import Light, Traced
from .settings import EnvMapSettings, MapSettings, ReflectionSettings

RANDOM_LOGIT = 5.0  # largest magnitude of a random map's (3DGS-DR)
DOUBLES_AT = (7_500, 13_500, 21_000)  # steps of a run of 30,000
FAR_MAP = "far_map"  # in a method's `parts`: what reflected rays see that pass what they are traced through


class CubeMap(Light):
    """A cube map whose texels hold colors in [0, 1], or their logits (`map_texels`).

    It may begin with an eighth of its texels an edge and double three times: a texel that few pixels see begins as what
    its surroundings have learned, and the early map is smooth enough to turn normals by.

    Attributes:
        texels: [6, S, S, 3].
        optimizer: of the texels.
    """

    def __init__(self, model: GaussianModel, settings: MapSettings, doublings: int = 0) -> None:
        self._model, self._settings, self._doublings = model, settings, doublings
        self._begun = False
        self._learns_colors = settings.rule.map_texels == "colors"
        self._stored = "map_colors" if self._learns_colors else "texels"
        self.become(torch.zeros(6, settings.envmap_size, settings.envmap_size, 3))

    @property
    def colors(self) -> Tensor:
        """[6, S, S, 3] in [0, 1], differentiable in the texels."""
        return self.texels if self._learns_colors else self.texels.sigmoid()

    def become(self, texels: Tensor) -> None:
        """Take these texels [6, S, S, 3], of which nothing has been learned."""
        self.texels = texels.detach().to(self._model.device).requires_grad_()
        self._layout = layout_of(texels.shape[1], self._model.device)
        self.optimizer = adam([{"params": [self.texels], "lr": self._settings.envmap_lr, "name": "texels"}])

    def show(self, colors: Tensor) -> None:
        """Become a map of these colors [6, S, S, 3] in (0, 1), of which nothing has been learned."""
        self.become(colors if self._learns_colors else colors.logit())

    def start(self, scene: Scene) -> None:
        self._begun = False

    def begin(self) -> None:
        self._begun = True
        size = self._settings.envmap_size
        if self._settings.rule.map_start == "random":
            uniform = torch.rand(6, size, size, 3, generator=self._model.generator)
            self.become(RANDOM_LOGIT * (2 * uniform - 1))
        else:
            self.become(torch.zeros(6, 2, 2, 3))  # gray; begin_step gives it its size

    def begin_step(self, step: int) -> None:
        size = self._size_at(step)
        if self._begun and size != self.texels.shape[1]:
            self.become(resized_cubemap(self.texels.detach(), self._layout, size))
        self._cut()

    def prepare(self) -> None:
        self._cut()

    def color(
        self, origins: Tensor, directions: Tensor, step: int | None, beta: Tensor | None = None
    ) -> tuple[Tensor, dict[str, Statistics]]:
        color = sample_cubemap(self.texels, directions.reshape(-1, 3), self._layout)
        return (color if self._learns_colors else color.sigmoid()).reshape(directions.shape), {}

    def optimizers(self) -> Sequence[torch.optim.Optimizer]:
        return (self.optimizer,)

    def model_bytes(self) -> dict[str, int]:
        return {ENV: 4 * self.texels.numel()}

    def most_bytes(self) -> int:
        return 4 * 6 * 3 * self._settings.envmap_size**2

    def training_state(self) -> dict[str, Any]:
        moments = optimizer_state(self.optimizer, {"texels": self.texels})
        return {"begun": self._begun, "texels": self.texels.detach(), "moments": moments}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        self._begun = state["begun"]
        self.become(state["texels"])
        restore_optimizer(self.optimizer, {"texels": self.texels}, state["moments"])

    def state(self) -> dict[str, Any]:
        return {self._stored: self.texels.detach()}

    def restore(self, state: Mapping[str, Any]) -> None:
        texels = state[self._stored]
        size = texels.shape[1]
        known = {self._size_before(doublings) for doublings in range(self._doublings + 1)}
        if size not in known:
            expected = " or ".join(map(str, sorted(known)))
            raise ValueError(
                f"the checkpoint's cube map has {size} texels an edge, expected {expected}: "
                f"envmap_size is {self._settings.envmap_size}"
            )
        self._begun = True
        self.become(texels)

    def _cut(self) -> None:
        """Cut colors to [0, 1], which a step of Adam may leave; what was cut goes on learning from there."""
        if self._learns_colors:
            with torch.no_grad():
                self.texels.clamp_(0, 1)

    def _size_at(self, step: int) -> int:
        """Texels along a face's edge at a step of the training."""
        doublings = DOUBLES_AT[len(DOUBLES_AT) - self._doublings :]
        return self._size_before(sum(step < self._model.schedule.at(doubling) for doubling in doublings))

    def _size_before(self, doublings: int) -> int:
        return max(2, self._settings.envmap_size >> doublings)


class Filtered(Part):
    """A map filtered for roughness: once for all images, anew in each step of a training.

    Attributes:
        map: the map, which is a part of its own.
    """

    def __init__(self, light: CubeMap) -> None:
        self.map = light
        self._of_images: RoughMap | None = None

    def begin_step(self, step: int) -> None:
        prefilter_of(self.map.texels.shape[1], self.map.texels.device)  # made here: a CUDA graph could not

    def prepare(self) -> None:
        self._of_images = self._filtered()

    def at(self, step: int | None) -> RoughMap:
        """The filtered map of a training's step, or of images (None); differentiable in the texels."""
        if step is not None:
            return self._filtered()
        assert self._of_images is not None
        return self._of_images

    def _filtered(self) -> RoughMap:
        return rough_map(self.map.colors, prefilter_of(self.map.texels.shape[1], self.map.texels.device))


def far_map(model: GaussianModel, settings: ReflectionSettings, light: Traced) -> dict[str, CubeMap]:
    """The part behind what is traced, put there where `traced_background` is "map"; none where it is not."""
    if settings.rule.traced_background != "map":
        return {}
    far = EnvMapSettings()
    light.behind = CubeMap(model, far, far.envmap_doublings)
    return {FAR_MAP: light.behind}
