"""Schedule: what happens at which step, in a run of any length, and to which parts of a method.

The settings give steps of a reference run: of 30,000, the length that 3DGS, 2DGS and EnvGS are tuned for, unless the
recipe names another (`reference_steps`). A run of another length stretches them: `at` maps a point of the reference run
to this run, `interval` maps an interval. An interval never falls below a floor, because some things take a number of
steps and not a share of the run:

| interval | floor | why |
|---|---|---|
| densification | 30 steps | its criterion is a mean over views |
| color sabotage, normal propagation | 1,000 steps | what has grown over its neighbors has to shrink back |
| opacity reset | 600 steps, 300 for the environment | opacities rise by 0.05 a step, then colors converge |

A run too short for an interval never does the thing: it could not recover. One of 2,000 steps has every phase, one of
800 is never disturbed and resets no opacity of the base. For the same reason nothing happens so late that fewer steps
are left: the floor of a disturbance or a reset, the whole interval of what else happens regularly.

Intervals are kept as fractions of a step and each event is rounded alone, so that events which coincide in the
reference run coincide in every run, and those that do not keep their distance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any

import torch
from torch import Tensor

from envgs_bench.core import Rendering, Scene, View

from ..recipes import REFERENCE_STEPS

DENSIFY_FLOOR = 30
DISTURB_FLOOR = 1000
RESET_FLOOR = 600
ENV_RESET_FLOOR = 300
RECOVERY = 100


@dataclass(frozen=True)
class Schedule:
    """The clock of one run. Steps count from 1 to `steps`.

    Attributes:
        steps: length of the run.
        stretches: whether a run of more steps than the reference run stretches it; else it goes through the reference
            run and then on with what holds at its end (EnvGS's released code).
        reference: length of the run that settings give steps of.
    """

    steps: int
    stretches: bool = True
    reference: int = REFERENCE_STEPS

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError(f"a run has {self.steps} steps, expected at least 1")

    @property
    def horizon(self) -> int:
        """Steps of this run that the reference run is mapped to."""
        return self.steps if self.stretches else min(self.steps, self.reference)

    def at(self, reference_step: int) -> int:
        """The step of this run that lies where `reference_step` lies in the reference run."""
        return _nearest(reference_step * self.horizon, self.reference)

    @cache  # noqa: B019 (a few intervals a run)
    def interval(self, reference_interval: int, floor: int) -> Fraction:
        """An interval of the reference run in steps of this run, at least `floor`; 0, never, where it is 0 there."""
        if reference_interval <= 0:
            return Fraction(0)
        return max(Fraction(reference_interval * self.horizon, self.reference), Fraction(floor))

    def rate(self, step: int, first: float, last: float) -> float:
        """A learning rate's log-linear decay (3DGS's, for positions): `first` at step 0 and `last` at the horizon."""
        progress = min(step / self.horizon, 1.0)
        return math.exp((1 - progress) * math.log(first) + progress * math.log(last))

    @property
    def rate_scale(self) -> float:
        """What a short run multiplies positions, rotations, colors and β's rates by: √(reference ÷ steps), 1 to 10.

        Adam moves a parameter by about its learning rate a step, so fewer steps reach less far; the square root is
        between keeping the steps and keeping the reach. Scales and opacities, which run away, keep their rates. The
        monocular normal loss gains the same weight, to hold the surfaces that move faster.
        """
        return min(max(1.0, math.sqrt(self.reference / self.steps)), 10.0)

    def recovers(self, step: int, *, stop: int, interval: int, floor: int = RESET_FLOOR) -> bool:
        """Whether `step` is within 100 steps after an opacity reset, every `interval` until before `stop` (reference).

        Opacities do not yet show then what is needed.

        A reference run resets every 3,000 steps and densifies every 100, so it never prunes in this time either.
        """
        n, d = self.interval(interval, floor).as_integer_ratio()
        if n == 0:
            return False
        count = (step * d - 1) // n  # the last multiple before `step`, unless it is rounded up to it
        reset = _nearest(count * n, d)
        if reset >= step:
            reset = _nearest((count - 1) * n, d)
        happened = reset < self.at(stop) and reset + floor <= self.steps
        return happened and 0 < reset < step < reset + RECOVERY

    def disturbs(self, step: int, *, start: int, stop: int, interval: int, reset_interval: int) -> bool:
        """Whether color sabotage and normal propagation, every `interval` in (start, stop], fall on `step`.

        Never on an opacity reset, which would undo them, and never within 1,000 steps of the last time. Between resets
        they keep their places: with 1,000 and 3,000 in the reference run, at a third and two thirds of the way.
        """
        return step in _disturbances(self, start, stop, interval, reset_interval)


@cache
def _disturbances(schedule: Schedule, start: int, stop: int, interval: int, reset_interval: int) -> frozenset[int]:
    """All steps at which `Schedule.disturbs`."""
    if interval <= 0:
        return frozenset()
    stretch = Fraction(schedule.horizon, schedule.reference)
    if reset_interval > 0:  # where resets are kept apart by their floor, what lies between them is stretched alike
        stretch = schedule.interval(reset_interval, RESET_FLOOR) / reset_interval
    steps, last = [], 0
    for count in range(1, int(schedule.at(stop) / (interval * stretch)) + 2):
        step = _nearest(*(count * interval * stretch).as_integer_ratio())
        coincides = reset_interval > 0 and count * interval % reset_interval == 0
        if schedule.at(start) < step <= schedule.at(stop) and not coincides and step - last >= DISTURB_FLOOR:
            steps.append(step)
            last = step
    return frozenset(steps)


@dataclass(frozen=True)
class Every:
    """Something that befalls a model again and again, right after Adam's step, and never too late to recover from it.

    Attributes:
        name: what tests and logs call it.
        action: what is done, given the step.
        interval: steps of this run between two times, as of a step; 0: never.
        start, stop: it happens after the one step and before the other, of this run.
        unless: steps at which it is left out.
        also: steps at which it happens besides, whatever the interval.
        recovery: steps that a run must have left after it; at least one, and at least as many as until the next time.
    """

    name: str
    action: Callable[[int], object]
    interval: Callable[[int], Fraction] = lambda step: Fraction(0)
    start: int = 0
    stop: int = 0
    unless: Callable[[int], bool] = lambda step: False
    also: Callable[[int], bool] = lambda step: False
    recovery: int = 1

    def due(self, step: int, end: int) -> bool:
        """Whether it happens after this step of a run that ends with step `end`."""
        interval = self.interval(step)
        if step + self.recovery > end or step + interval > end:
            return False
        regular = self.start < step < self.stop and falls_on(step, interval) and not self.unless(step)
        return regular or self.also(step)


class Part:
    """A part of a method that learns, remembers or changes something; each hook does nothing unless overridden."""

    def start(self, scene: Scene) -> None:
        """Become as before the first step of a training, whose sets have just been made."""

    def begin_step(self, step: int) -> None:
        """Get ready for a training step, before anything is drawn: another phase, another resolution, other rates."""

    def phase(self, step: int) -> Hashable:
        """What the host decides in a step: steps of equal phases launch the same kernels."""
        return ()

    def losses(self, rendering: Rendering, view: View, step: int) -> dict[str, Tensor]:
        """What a step minimizes besides, weighted scalars by name; see `GaussianMethod.losses`."""
        return {}

    def optimizers(self) -> Sequence[torch.optim.Optimizer]:
        """What moves its parameters; of the tensors that a CUDA graph holds."""
        return ()

    def events(self) -> Sequence[Every]:
        """What it does between steps, in this order."""
        return ()

    def prepare(self) -> None:
        """Make what images need once; the sets are prepared."""

    def model_bytes(self) -> dict[str, int]:
        """Bytes of its parameters as float32, by the set that they are counted as; see `Method.model_bytes`."""
        return {}

    def most_bytes(self) -> int:
        """Bytes of its parameters as float32, the most of them at any step."""
        return 0

    def training_state(self) -> dict[str, Any]:
        """All that later steps depend on."""
        return {}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        """Become what `training_state` returned, tensors on the CPU."""

    def state(self) -> dict[str, Any]:
        """What a checkpoint holds of it, under keys that no other part has."""
        return {}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Become what `state` returned, among other parts' keys; tensors on the method's device."""


def set_rate(group: dict[str, Any], rate: float) -> None:
    """Give an optimizer's group another learning rate, on the device where it is read there."""
    if isinstance(group["lr"], Tensor):
        group["lr"].fill_(rate)
    else:
        group["lr"] = rate


def falls_on(step: int, interval: Fraction) -> bool:
    """Whether a multiple of the interval is rounded to `step`; never where the interval is 0."""
    n, d = interval.as_integer_ratio()
    if n == 0:
        return False
    count = _nearest(step * d, n)
    return count > 0 and _nearest(count * n, d) == step


def _nearest(numerator: int, denominator: int) -> int:
    """The integer nearest to a fraction ≥ 0, the upper of two: whole numbers, since every step asks several times."""
    return (2 * numerator + denominator) // (2 * denominator)
