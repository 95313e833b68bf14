"""FilteredMapMethod: what methods share whose map lights surfaces of any roughness."""

from __future__ import annotations

import torch

from .learned_map import MapMethod, MapSettings
from .lighting.prefiltered_cubemap import RoughMap, prefilter_of, rough_map


class FilteredMapMethod(MapMethod):
    """A method with a map that it filters for roughness: once for all images, anew in each step of a training."""

    def __init__(self, settings: MapSettings, device: torch.device | str = "cpu", seed: int = 0) -> None:
        super().__init__(settings, device, seed)
        self._light: RoughMap | None = None  # of images

    def before_step(self, step: int) -> None:
        super().before_step(step)
        prefilter_of(self.texels.shape[1], self.device)  # made here: the step itself may be recorded on a GPU

    def prepare(self) -> None:
        super().prepare()
        self._light = self._filtered_map()

    def light(self, step: int | None) -> RoughMap:
        """The filtered map of a training's step, or of images (None); differentiable in `texels`."""
        if step is not None:
            return self._filtered_map()
        assert self._light is not None
        return self._light

    def _filtered_map(self) -> RoughMap:
        return rough_map(self.texels.sigmoid(), prefilter_of(self.texels.shape[1], self.device))
