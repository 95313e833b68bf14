"""Pruning: a model without the primitives that its training views miss least, as far as an error or a count allows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

from torch import Tensor

from envgs_bench.parts import BASE

from ..training.losses import pruned_ssim_share
from ..training.schedule import DENSIFY_FLOOR, Every, Part
from .beside_noise import share_beside_noise
from .drawn_views import DrawnViews
from .importance import least_of, without_least
from .model import GaussianModel
from .monitor import FULL
from .pruning_bound import PruningBound, quality_of

PRUNINGS = "prunings:"  # how the note begins that says what they found
PRUNE_EVERY, PRUNE_UNTIL = 1_500, 28_000  # steps of a run of 30,000: between two prunings, and before which they end


class Prunings(Part):
    """The prunings of one run: each as far as `prune` may go, and none while views are drawn worse than their bound.

    Attributes:
        bound: what they may cost.
        counts: primitives before the first pruning, and after each time that one was due.
        beside_noise: of the views' squared error, what was not their noise as prunings began.
    """

    def __init__(
        self,
        drawn: DrawnViews,
        notes: list[str],
        tell: Callable[[float], None],
        lpips: Callable[[Tensor, Tensor], Tensor] | None = None,
    ) -> None:
        """
        Args:
            notes: where the method says what was found.
            tell: what is told `beside_noise`, as soon as it is found.
            lpips: of a picture and its target, [H, W, 3] in [0, 1]; None: it is not to be had, and the bound is PSNR's.
        """
        self._drawn, self._notes, self._tell, self._lpips = drawn, notes, tell, lpips
        self.bound = PruningBound()
        self.counts: list[int] = []
        self.beside_noise = 1.0

    def begin(self, step: int) -> None:
        """Find how noisy the views are, before anything is pruned."""
        self._drawn.prepare()
        self.beside_noise = share_beside_noise(self._drawn.pictures())
        self._drawn.model.prepared.clear()
        self._tell(self.beside_noise)

    def __call__(self, step: int) -> None:
        """Prune after this step, where the bound allows it."""
        self._drawn.prepare()
        allowed = self.bound.allows(quality_of(self._drawn.pictures(), self._lpips))
        self.counts = self.counts or [self._count()]
        if allowed:
            prune(self._drawn, self._drawn.model.settings.prune_error)
        self.counts.append(self._count())
        self._note()

    def _count(self) -> int:
        return sum(self._drawn.model.primitives().values())

    def _note(self) -> None:
        due, done = len(self.counts) - 1, sum(b < a for a, b in pairwise(self.counts))
        words = f"{PRUNINGS} {done} of {due}: {self.counts[-1]:,} of {self.counts[0]:,} primitives are left; "
        if self.bound.beyond:
            words += f"the last was left out, as training views lost {self.bound.beyond}; "
        words += f"before it they had {self.bound.seen}; "
        words += f"{self.beside_noise:.0%} of their error was not noise as prunings began, "
        words += f"so SSIM had {pruned_ssim_share(self.beside_noise):.2f} of the photometric loss"
        words += "" if self._lpips else "; LPIPS was not asked, as VGG-16's weights are not here"
        self._notes[:] = [note for note in self._notes if not note.startswith(PRUNINGS)] + [words]

    def training_state(self) -> dict[str, Any]:
        state = {"counts": list(self.counts), "bound": self.bound.training_state()}
        return state | {"beside_noise": self.beside_noise}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        self.counts = list(state["counts"])
        self.bound.restore_training(state["bound"])
        self.beside_noise = state["beside_noise"]
        self._tell(self.beside_noise)
        if self.counts:
            self._note()


def prune(drawn: DrawnViews, rise: float) -> None:
    """Remove what the views miss least, of whichever set, until their squared error is 1 + `rise` times what it was.

    Sets grow no more then: relocation would fill them up to their size limits again.
    """
    worth, model = drawn.worth(), drawn.model
    most = (1 + rise) * drawn.squared_error({})
    for name, rows in without_least(worth, most, drawn.squared_error).items():
        model.sets[name].keep(rows)
        model.left[name] = model.size(name)


def prune_to(drawn: DrawnViews, most: int) -> None:
    """Remove what the views miss least, of whichever set, until there are at most so many primitives."""
    left = gone = sum(drawn.model.primitives().values()) - most
    if left <= 0:
        return
    kept_without = least_of(drawn.worth())
    while left > 0:  # the last of a set stays, and another goes in its place
        kept = kept_without(gone)
        left = sum(int(rows.sum()) for rows in kept.values()) - most
        gone += left
    for name, rows in kept.items():
        drawn.model.sets[name].keep(rows)


def _too_early(model: GaussianModel, step: int) -> bool:
    """Whether opacities come back from a reset, or growth that fills a size limit has not done so yet."""
    policy, most = model.policies[BASE], model.bound(BASE)
    grows = policy.fills_limit and step < model.schedule.at(policy.grows_until)
    return policy.resets.recovers(step) or (grows and model.size(BASE) < FULL * most)


def events_of(model: GaussianModel, prunings: Prunings | None, of_parts: Sequence[Every]) -> list[Every]:
    """What a run does to the sets between steps, in this order: prunings, the base's own, parts', other sets'."""
    schedule, events = model.schedule, []
    if prunings is not None:
        every = schedule.interval(PRUNE_EVERY, DENSIFY_FLOOR)
        start, stop = schedule.at(model.settings.prune_from), schedule.at(PRUNE_UNTIL)
        events.append(Every("begin_prunings", prunings.begin, also=lambda step: step == start))
        events.append(Every("prune", prunings, lambda step: every, start, stop, unless=partial(_too_early, model)))
    for name, policy in model.policies.items():
        events.append(policy.densification(partial(model.densify, name)))
        if not policy.fills_limit:
            events.append(policy.opacity_reset(partial(model.reset_opacity, name)))
        if name == BASE:
            events += of_parts
    return events
