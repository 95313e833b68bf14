"""Stop: how a run is asked to end, and when it does so: at once, or after the training step under way."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

STEP_SECONDS = 10.0  # how long a step under way may go on
INTERRUPTED = 130  # a shell's exit status of what Ctrl-C ended


class Stop:
    """A request to end. Within `deferred` it waits for a step's end, when the model is whole and can be saved."""

    def __init__(self) -> None:
        self._deferred = False
        self._wanted: BaseException | None = None

    @property
    def wanted(self) -> bool:
        return self._wanted is not None

    @property
    def reason(self) -> BaseException | None:
        """What the run was asked to end with; None where nobody asked."""
        return self._wanted

    def ask(self, error: BaseException) -> None:
        """End with `error`, and at once if asked again or if the step under way takes too long. For signal handlers."""
        if self._deferred and self._wanted is None:
            self._wanted = error
            signal.setitimer(signal.ITIMER_REAL, STEP_SECONDS)  # the worker's SIGALRM, which asks again
        else:
            self._wanted = self._wanted or error  # lest whoever it is raised in swallows it
            raise self._wanted

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """Within the block, requests wait for `heed`, or for the block's end."""
        self._deferred = True
        try:
            yield
        finally:
            self._deferred = False
        self.heed()

    def heed(self) -> None:
        """Raise what was asked for."""
        if self._wanted is not None:
            signal.setitimer(signal.ITIMER_REAL, 0)
            raise self._wanted
