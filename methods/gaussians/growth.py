"""When the base set grows and has its opacities reset, and how large it may get: the settings on a run's clock."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from envgs_bench.core import Scene

from ..settings import GaussianSettings
from ..training.schedule import DENSIFY_FLOOR, RECOVERY, RESET_FLOOR, Schedule
from .densification import Oversized


@dataclass(frozen=True)
class BaseGrowth:
    """Steps count from 1 to the run's length.

    Attributes:
        on_white: whether the scene's background is white.
    """

    settings: GaussianSettings
    schedule: Schedule
    on_white: bool

    def events(self, step: int, every: Fraction) -> set[str]:
        """What befalls the base set after Adam's step number `step`, of prune, densify_base and reset_base_opacity.

        Args:
            every: steps of this run between two densifications as of `step`; 0: never.
        """
        s, schedule = self.settings, self.schedule
        recovers = self.recovers(step)
        happens = set()
        if not recovers and schedule.densifies(step, start=s.densify_from, stop=s.densify_until, every=every):
            happens.add("densify_base")
        pruned_every = schedule.interval(s.prune_every, DENSIFY_FLOOR)
        if (
            s.prune_error > 0
            and not recovers
            and schedule.densifies(step, start=s.prune_from, stop=s.prune_until, every=pruned_every)
        ):
            happens.add("prune")
        if self._resets(step):
            happens.add("reset_base_opacity")
        return happens

    def _resets(self, step: int) -> bool:
        s = self.settings
        regular = self.schedule.resets(step, stop=s.densify_until, interval=s.opacity_reset_every)
        return regular or step == self._reset_on_white()

    def recovers(self, step: int) -> bool:
        """Whether opacities, at this step, do not yet show what is needed: a reset was less than 100 steps before."""
        s, on_white = self.settings, self._reset_on_white()
        regular = self.schedule.recovers(step, stop=s.densify_until, interval=s.opacity_reset_every)
        return regular or 0 < on_white < step < on_white + RECOVERY

    def oversized(self, step: int) -> Oversized:
        """What a densification after `step` does with what is oversized; 3DGS's pruning waits for the first reset."""
        s = self.settings
        if s.oversized == "split":
            return "split"
        return "prune" if 0 < self.schedule.interval(s.opacity_reset_every, RESET_FLOOR) < step else "keep"

    def _reset_on_white(self) -> int:
        """The step of 3DGS's reset over a white background, of what has been put before it for nothing; 0: none.

        A run that is too short for any other reset has none of these either.
        """
        s, schedule = self.settings, self.schedule
        resets = 0 < schedule.interval(s.opacity_reset_every, RESET_FLOOR) < schedule.at(s.densify_until)
        return schedule.at(s.densify_from) if s.reset_on_white and self.on_white and resets else 0


def max_base_primitives(settings: GaussianSettings, scene: Scene) -> int:
    """The most primitives that the base set may have, as many as it starts with at least; 0: any number."""
    if settings.pixels_per_primitive <= 0:
        return settings.max_primitives
    pixels = sum(view.camera.width * view.camera.height for view in scene.train)
    bound = max(len(scene.points), int(pixels / settings.pixels_per_primitive))
    return min(settings.max_primitives or bound, bound)
