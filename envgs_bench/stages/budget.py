"""Budget of a run: its method, made to stay within it, by its size at every step and by timed frames at its end."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from envgs_bench.core import Camera, Scene
from envgs_bench.methods.gaussians.budget import LEAST_PRIMITIVES
from envgs_bench.methods.method import Budget, Method
from envgs_bench.methods.registry import create_method
from envgs_bench.records import ELSEWHERE, Timing
from envgs_bench.settings import BudgetChoice, RunSettings, SettingsError

from .timing import time_views

ANY = 10**9  # primitives, more than any device holds: until frames have been timed
LOOKS = 20  # at frames in a run, in the middle of each twentieth: opacities have come back from their resets there
# The shares of a run between which there are looks. Before, primitives are transparent and large, which takes longest,
# and no picture shows yet what a reflection's are worth; after, training wins back what the last limit cost.
LOOK_FROM, LOOK_UNTIL = 0.5, 0.93
TIMED_VIEWS, TIMED_FRAMES, TIMED_SECONDS = 8, 5, 0.5  # a look: training views, and each one's frames and seconds
ROOM = 0.95  # of the limit is what training aims at: views between the training views may take longer
MOST_CUT = 0.5  # × the primitives that a model has: what it keeps at least at once, as clocks stumble
LEAST_CUT = 0.9  # × those of a model that is too slow at the end: what it keeps at most

Clock = Callable[[Method, Sequence[Camera]], float]  # how long a picture takes, ms


def limited_method(settings: RunSettings, device: str) -> Method:
    """A new method of these settings, limited where the run has a budget.

    Raises:
        ValueError: settings that the method does not have, or a budget that it cannot stay within.
    """
    method = create_method(settings.method.kind, settings.method.settings, device, settings.seed)
    if settings.budget is not None:
        method.limit(_budget(settings.budget, ANY))
    return method


def check_budget(settings: RunSettings) -> None:
    """Raise a SettingsError where the run has a budget that its method cannot stay within."""
    if settings.budget is None:
        return
    if settings.method.kind in ELSEWHERE:
        raise SettingsError(
            f"method {settings.method.kind} trains no model of ours that a budget could limit: run it without budget"
        )
    try:
        limited_method(settings, "cpu")
    except ValueError as error:
        raise SettingsError(f"method {settings.method.name}: {error}") from error


def picture_ms(method: Method, cameras: Sequence[Camera]) -> float:
    """How long a picture of the method as it is takes on its device, ms: the mean of the cameras' quickest frames.

    A few frames, beside a training: what made some of them slower is more often the machine than the model.
    """
    method.prepare()
    frames = time_views(method.picture, cameras, method.device, TIMED_FRAMES, TIMED_SECONDS)
    return statistics.mean(map(min, frames.times_ms))


class FrameLimit:
    """How many primitives `budget.frame_ms` leaves room for, by timed frames.

    While the method trains, pictures of some training views are timed, and it is limited to as many primitives as would
    take ROOM of the limit if frame time were in proportion. At the end those frames decide that the record tells of.

    Attributes:
        most: primitives that there is room for, by what was timed last.
    """

    def __init__(
        self, method: Method, choice: BudgetChoice, scene: Scene, steps: int, clock: Clock = picture_ms
    ) -> None:
        assert choice.frame_ms is not None
        self.most = ANY
        self._method, self._choice, self._clock, self._frame_ms = method, choice, clock, choice.frame_ms
        every = max(1, len(scene.train) // TIMED_VIEWS)
        self._cameras = [view.camera.to(method.device) for view in scene.train[::every]]
        middles = (round((look + 0.5) * steps / LOOKS) for look in range(LOOKS))
        self._looks = {step for step in middles if LOOK_FROM * steps < step < LOOK_UNTIL * steps}

    def due(self, step: int) -> bool:
        """Whether frames are timed after this step."""
        return step in self._looks

    def look(self) -> None:
        """Time frames, and limit the method by them.

        Raises:
            ValueError: the method keeps more than it may.
        """
        self._method.settle()
        frame_ms = self._clock(self._method, self._cameras)
        self._keep(max(ROOM * self._frame_ms / frame_ms, float(frame_ms <= self._frame_ms)))

    def hold(self, timed: Callable[[], Timing]) -> Timing:
        """What was timed of the trained method, made smaller until that is within the limit.

        Raises:
            ValueError: hardly a primitive is left and frames still take too long, or as of `look`.
        """
        timing = timed()
        while timing.frame_ms > self._frame_ms:
            if (count := self._count()) <= LEAST_PRIMITIVES:
                raise ValueError(
                    f"budget.frame_ms is {self._frame_ms:g}, and pictures of {count:,} primitives take "
                    f"{timing.frame_ms:.3g} ms here: give it more, or smaller pictures"
                )
            self._keep(min(LEAST_CUT, ROOM * self._frame_ms / timing.frame_ms))
            timing = timed()
        return timing

    @property
    def sentence(self) -> str:
        """What was found, for the record."""
        return (
            f"budget.frame_ms={self._frame_ms:g}: {self._count():,} primitives at the end; timed frames left room for "
            f"{self.most:,}"
        )

    def state(self) -> dict[str, Any]:
        return {"most": self.most}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Become what `state` returned, of a method that goes on."""
        self.most = state["most"]
        self._method.limit(_budget(self._choice, self.most))

    def _keep(self, share: float) -> None:
        """Limit the method to that share, above 1 too, of the primitives that it has."""
        self.most = min(ANY, max(LEAST_PRIMITIVES, int(max(MOST_CUT, share) * self._count())))
        self._method.limit(_budget(self._choice, self.most))
        if (kept := self._count()) > self.most:
            raise ValueError(
                f"{type(self._method).__name__} has {kept:,} primitives after `limit` left it {self.most:,}: for "
                "budget.frame_ms a method must keep to a limit between steps too"
            )

    def _count(self) -> int:
        return sum(self._method.primitives().values())


def _budget(choice: BudgetChoice, most: int) -> Budget:
    """What the method is to keep to, where frames leave room for so many primitives."""
    limits = [limit for limit in (choice.primitives, most if choice.frame_ms else None) if limit is not None]
    return Budget(primitives=min(limits, default=None), mb=choice.mb)
