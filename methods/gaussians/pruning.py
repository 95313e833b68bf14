"""Pruning: a model without the primitives that its training views miss least, as far as an error allows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import torch
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Rendering, View

from ..gaussian_model import GaussianModel
from .importance import removal_errors, without_least

TRANSPARENT = -100.0  # logit of an opacity that draws nothing


def prune(model: GaussianModel, views: Callable[[], Iterable[View]], rise: float) -> None:
    """Remove what the views miss least, of whichever set, until their squared error is 1 + `rise` times what it was.

    Args:
        views: the training views on the model's device, from the first one at each call.
    """

    def draw(sets: Mapping[str, GaussianSet], camera: Camera) -> Rendering:
        model.prepared = dict(sets)
        return model.draw(camera, None)[0]

    model.prepare()
    errors = removal_errors(model.prepared, draw, views(), model.generator)
    most = (1 + rise) * _squared_error(model, views(), {})
    for name, rows in without_least(errors, most, lambda drawn: _squared_error(model, views(), drawn)).items():
        model.sets[name].keep(rows)


def _squared_error(model: GaussianModel, views: Iterable[View], drawn: Mapping[str, Tensor]) -> float:
    """Σ over the views' pixels and channels where of each set only the rows of a mask [N] are drawn."""
    logits = {name: model.sets[name].parameters.detached()["opacity_logits"] for name in drawn}
    before = {name: values.clone() for name, values in logits.items()}
    for name, values in logits.items():
        values.masked_fill_(~drawn[name], TRANSPARENT)
    model.prepare()
    error = torch.zeros((), device=model.device)
    for view in views:
        error += (model.draw(view.camera, None)[0].color - view.rgb(model.device)).square().sum()
    for name, values in before.items():
        logits[name].copy_(values)
    model.prepared.clear()
    return float(error)
