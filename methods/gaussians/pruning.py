"""Pruning: a model without the primitives that its training views miss least, as far as an error allows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from envgs_bench.core import Camera, GaussianSet, Rendering, View
from envgs_bench.parts import BASE

from ..training.schedule import DENSIFY_FLOOR, Every, Part
from .importance import removal_errors, without_least
from .model import GaussianModel
from .pruning_bound import PruningBound, quality_of

TRANSPARENT = -100.0  # logit of an opacity that draws nothing
PRUNINGS = "prunings:"  # how the note begins that says what they found
PRUNE_EVERY, PRUNE_UNTIL = 1_500, 28_000  # steps of a run of 30,000: between two prunings, and before which they end


class Prunings(Part):
    """The prunings of one run: each as far as `prune` may go, until what they cost is more than their bound.

    Attributes:
        bound: what they may cost.
        counts: primitives before the first pruning, and after each.
    """

    def __init__(
        self,
        model: GaussianModel,
        draw: Callable[[Camera, None], tuple[Rendering, object]],
        prepare: Callable[[], None],
        views: Callable[[], Iterable[View]],
        notes: list[str],
    ) -> None:
        """
        Args:
            draw, prepare, views: as of `prune`.
            notes: where the method says what was found.
        """
        self._model, self._draw, self._prepare, self._views, self._notes = model, draw, prepare, views, notes
        self.bound = PruningBound()
        self.counts: list[int] = []

    def __call__(self, step: int) -> None:
        """Prune after this step, where the bound allows it."""
        if not self.bound.ended:
            self._prepare()
            allowed = self.bound.allows(quality_of((self._draw(v.camera, None)[0], v) for v in self._views()))
            self._model.prepared.clear()
            self.counts = self.counts or [self._count()]
            if allowed:
                prune(self._model, self._draw, self._prepare, self._views, self._model.settings.prune_error)
                self.counts.append(self._count())
            self._tell()

    def _count(self) -> int:
        return sum(self._model.primitives().values())

    def _tell(self) -> None:
        words = f"{PRUNINGS} {len(self.counts) - 1}: {self.counts[-1]:,} of {self.counts[0]:,} primitives are left; "
        words += f"they ended as {self.bound.ended}" if self.bound.ended else "each went as far as training views allow"
        self._notes[:] = [note for note in self._notes if not note.startswith(PRUNINGS)] + [words]

    def training_state(self) -> dict[str, Any]:
        return {"counts": list(self.counts), "bound": self.bound.training_state()}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        self.counts = list(state["counts"])
        self.bound.restore_training(state["bound"])
        if self.counts:
            self._tell()


def prune(
    model: GaussianModel,
    draw: Callable[[Camera, None], tuple[Rendering, object]],
    prepare: Callable[[], None],
    views: Callable[[], Iterable[View]],
    rise: float,
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


def events_of(model: GaussianModel, prunings: Prunings | None, of_parts: Sequence[Every]) -> list[Every]:
    """What a run does to the sets between steps, in this order: prunings, the base's own, parts', other sets'."""
    schedule, events = model.schedule, []
    if prunings is not None:
        every = schedule.interval(PRUNE_EVERY, DENSIFY_FLOOR)
        span = schedule.at(model.settings.prune_from), schedule.at(PRUNE_UNTIL)
        recovers = model.policies[BASE].resets.recovers
        events.append(Every("prune", prunings, lambda step: every, *span, unless=recovers))
    for name, policy in model.policies.items():
        events.append(policy.densification(partial(model.densify, name), partial(model.size, name)))
        if policy.growth == "gradient":
            events.append(policy.opacity_reset(partial(model.reset_opacity, name)))
        if name == BASE:
            events += of_parts
    return events
