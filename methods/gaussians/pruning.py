"""Pruning: a model without the primitives that its training views miss least, as far as an error allows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

import torch
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Rendering, View
from envgs_bench.parts import BASE

from ..training.schedule import DENSIFY_FLOOR, Every
from .importance import removal_errors, without_least
from .model import GaussianModel

TRANSPARENT = -100.0  # logit of an opacity that draws nothing
PRUNE_EVERY, PRUNE_UNTIL = 1_500, 28_000  # steps of a run of 30,000: between two prunings, and before which they end


def prune(
    model: GaussianModel,
    draw: Callable[[Camera, None], tuple[Rendering, object]],
    prepare: Callable[[], None],
    views: Callable[[], Iterable[View]],
    rise: float,
    step: int,
) -> None:
    """Remove what the views miss least, of whichever set, until their squared error is 1 + `rise` times what it was.

    Args:
        draw: an image, from the model's prepared sets, as of `GaussianMethod.draw`.
        prepare: make the sets as they are, and all that images need besides.
        views: the training views on the model's device, from the first one at each call.
    """

    def draw_sets(sets: Mapping[str, GaussianSet], camera: Camera) -> Rendering:
        model.prepared = dict(sets)
        return draw(camera, None)[0]

    def squared_error(drawn: Mapping[str, Tensor]) -> float:
        """Σ over the views' pixels and channels where of each set only the rows of a mask [N] are drawn."""
        logits = {name: model.sets[name].parameters.detached()["opacity_logits"] for name in drawn}
        before = {name: values.clone() for name, values in logits.items()}
        for name, values in logits.items():
            values.masked_fill_(~drawn[name], TRANSPARENT)
        prepare()
        error = torch.zeros((), device=model.device)
        for view in views():
            error += (draw(view.camera, None)[0].color - view.rgb(model.device)).square().sum()
        for name, values in before.items():
            logits[name].copy_(values)
        model.prepared.clear()
        return float(error)

    prepare()
    errors = removal_errors(model.prepared, draw_sets, views())
    most = (1 + rise) * squared_error({})
    for name, rows in without_least(errors, most, squared_error).items():
        model.sets[name].keep(rows)


def events_of(model: GaussianModel, prune_all: Callable[[int], None], of_parts: Sequence[Every]) -> list[Every]:
    """What a run does to the sets between steps, in this order: prunings, the base's own, parts', other sets'."""
    s, schedule, base = model.settings, model.schedule, model.policies[BASE]
    events = []
    if s.prune_error > 0:
        every = schedule.interval(PRUNE_EVERY, DENSIFY_FLOOR)
        span = schedule.at(s.prune_from), schedule.at(PRUNE_UNTIL)
        events.append(Every("prune", prune_all, lambda step: every, *span, unless=base.resets.recovers))
    for name, policy in model.policies.items():
        events.append(policy.densification(partial(model.densify, name), partial(model.size, name)))
        if policy.growth == "gradient":
            events.append(policy.opacity_reset(partial(model.reset_opacity, name)))
        if name == BASE:
            events += of_parts
    return events
