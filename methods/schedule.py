"""Schedule: what happens at which step, in a run of any length.

The settings give steps of a run of 30,000, the length that 3DGS, 2DGS and EnvGS are tuned for. A run of another length
stretches them: `at` maps a point of the reference run to this run, `every` maps an interval. An interval never falls
below a floor, because some things take a number of steps and not a share of the run:

| interval | floor | why |
|---|---|---|
| densification | 30 steps | its criterion is a mean over views |
| color sabotage, normal propagation | 1,000 steps | what has grown over its neighbors has to shrink back |
| opacity reset | 600 steps, 300 for the environment | opacities climb by 0.05 a step, then colors settle |

A run too short for an interval never does the thing: it could not recover. One of 2,000 steps has every phase, one of
800 is never disturbed and resets no opacity of the base.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

REFERENCE_STEPS = 30_000
DENSIFY_FLOOR = 30
DISTURB_FLOOR = 1000
RESET_FLOOR = 600
ENV_RESET_FLOOR = 300
RECOVERY = 100


@dataclass(frozen=True)
class Schedule:
    """The clock of one run. Steps count from 1 to `steps`."""

    steps: int

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError(f"a run has {self.steps} steps, expected at least 1")

    def at(self, reference_step: int) -> int:
        """The step of this run that lies where `reference_step` lies in a run of 30,000."""
        return round(reference_step * self.steps / REFERENCE_STEPS)

    def every(self, reference_interval: int, floor: int) -> int:
        """An interval of the reference run in steps of this run, at least `floor`."""
        return max(self.at(reference_interval), floor)

    def rate(self, step: int, first: float, last: float) -> float:
        """A learning rate's log-linear decay (3DGS's, of positions): `first` at step 0 and `last` at the run's end."""
        progress = min(step / self.steps, 1.0)
        return math.exp((1 - progress) * math.log(first) + progress * math.log(last))

    @property
    def rate_scale(self) -> float:
        """What a short run multiplies the rates of positions, rotations, colors and β by: √(30,000 / steps), 1 to 10.

        Adam moves a parameter by about its learning rate a step, so fewer steps reach less far; the square root is
        between keeping the steps and keeping the reach. Scales and opacities, which run away, keep their rates. The
        monocular normal loss gains the same weight, to hold the surfaces that move faster.
        """
        return min(max(1.0, math.sqrt(REFERENCE_STEPS / self.steps)), 10.0)

    def densification_interval(self, reference_interval: int) -> int:
        """Steps of this run between two densifications; 0, never, where the reference interval is 0."""
        return self.every(reference_interval, DENSIFY_FLOOR) if reference_interval > 0 else 0

    def densifies(self, step: int, *, start: int, stop: int, every: int) -> bool:
        """Whether a densification `every` so many steps of this run, between `start` and `stop` (reference), is due."""
        return every > 0 and self.at(start) < step < self.at(stop) and step % every == 0

    def resets(self, step: int, *, stop: int, interval: int, floor: int = RESET_FLOOR) -> bool:
        """Whether an opacity reset, every `interval` until before `stop` (reference), falls on `step`."""
        return step < self.at(stop) and self._falls_on(step, interval, floor)

    def recovers(self, step: int, *, stop: int, interval: int, floor: int = RESET_FLOOR) -> bool:
        """Whether `step` is within 100 steps after such a reset, when opacities say nothing about need.

        A reference run resets every 3,000 steps and densifies every 100, so it never prunes in this time either.
        """
        if interval <= 0:
            return False
        since = step % self.every(interval, floor)
        return 0 < since < RECOVERY and since < step and step - since < self.at(stop)

    def disturbs(self, step: int, *, start: int, stop: int, interval: int) -> bool:
        """Whether color sabotage and normal propagation, every `interval` in (start, stop], fall on `step`."""
        in_time = self.at(start) < step <= self.at(stop)
        return in_time and self._falls_on(step, interval, DISTURB_FLOOR)

    def _falls_on(self, step: int, interval: int, floor: int) -> bool:
        """Whether `step` is a multiple of the reference interval; never where that is 0."""
        return interval > 0 and step % self.every(interval, floor) == 0
