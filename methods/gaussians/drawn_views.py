"""DrawnViews: a model's pictures of its training views, and what they say of each of its primitives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Rendering, Statistics, View

from .importance import removal_errors
from .model import GaussianModel

SAMPLED = 16  # views of a sample at most
TRANSPARENT = -100.0  # logit of an opacity that draws nothing


@dataclass(frozen=True)
class DrawnViews:
    """Pictures of a model as it is.

    Attributes:
        draw: an image, and each set's statistics, from the model's prepared sets: as of `GaussianMethod.draw`.
        prepare: make the sets as they are, and all that images need besides.
        views: the training views on the model's device, from the first one at each call.
        sample: some of them, which tell how well the model draws, with a part of its primitives or all.
    """

    model: GaussianModel
    draw: Callable[[Camera, None], tuple[Rendering, Mapping[str, Statistics]]]
    prepare: Callable[[], None]
    views: Callable[[], Iterable[View]]
    sample: Callable[[], Iterable[View]]

    def pictures(self) -> Iterator[tuple[Rendering, View]]:
        """The sample's pictures from the prepared sets, each with its view."""
        for view in self.sample():
            yield self.draw(view.camera, None)[0], view

    def squared_error(self, drawn: Mapping[str, Tensor]) -> float:
        """Σ over the sample's pixels and channels where of each set only the rows of a mask [N] are drawn."""
        logits = {name: self.model.sets[name].parameters.detached()["opacity_logits"] for name in drawn}
        before = {name: values.clone() for name, values in logits.items()}
        for name, values in logits.items():
            values.masked_fill_(~drawn[name], TRANSPARENT)
        self.prepare()
        error = torch.zeros((), device=self.model.device)
        for view in self.sample():
            error += (self.draw(view.camera, None)[0].color - view.rgb(self.model.device)).square().sum()
        for name, values in before.items():
            logits[name].copy_(values)
        self.model.prepared.clear()
        return float(error)

    def worth(self) -> dict[str, Tensor]:
        """What each primitive is worth, [N] of each set: the least goes first, by the setting `prune_by`."""
        self.prepare()
        by = self.model.settings.prune_by
        if by == "opacity":
            found = {name: gaussians.opacities for name, gaussians in self.model.prepared.items()}
        elif by == "weight":
            found = self._weights()
        else:
            found = removal_errors(self.model.prepared, self._draw_sets, self.views())
        self.model.prepared.clear()
        return found

    def _weights(self) -> dict[str, Tensor]:
        """Σ of the blending weight T·α over the views' pixels, or of the rays that meet a set."""
        sums = {name: torch.zeros_like(gaussians.opacities) for name, gaussians in self.model.prepared.items()}
        for view in self.views():
            for name, statistics in self.draw(view.camera, None)[1].items():
                sums[name] += statistics.weights
        return sums

    def _draw_sets(self, sets: Mapping[str, GaussianSet], camera: Camera) -> Rendering:
        self.model.prepared = dict(sets)
        return self.draw(camera, None)[0]
