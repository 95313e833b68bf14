"""Interruption: Ctrl-C and SIGTERM for a sweep. Noted while a run is under way, which is then ended; raised otherwise.

Python raises KeyboardInterrupt wherever it happens to be. A sweep must not take it in the middle of a record, nor lose
it because a run has just ended, nor leave it to joblib, which kills the runs of the other processes.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any

from envgs_bench.stages.stop import INTERRUPTED

from .processes import end_with

SAME_SECONDS = 1.0  # signals within that time are one: a terminal and `timeout` signal a group and its leader
SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interruption:
    """What the user wants of this process.

    A sweep on several processes has a file that is there when it is to end. The sweep's own process makes it
    (`lead`); those that run its jobs look for it (`follow`).

    Attributes:
        insisted: the sweep is to end without waiting for what the runs under way may save.
        on_request: called from the signal handler, to pass the signal on.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget what was wanted: another sweep begins."""
        self.insisted = False
        self.on_request: Callable[[], None] | None = None
        self._at: float | None = None
        self._held = 0
        self._stop_file: Path | None = None
        self._leads = False
        self._leader: int | None = None

    @property
    def requested(self) -> bool:
        """Whether the sweep is to end."""
        return self._at is not None or (self._stop_file is not None and self._stop_file.exists())

    @contextmanager
    def handled(self) -> Iterator[None]:
        """Signals come here within the block."""
        before: list[Any] = [signal.signal(number, self._arrive) for number in SIGNALS]
        try:
            yield
        finally:
            for number, handler in zip(SIGNALS, before, strict=True):
                signal.signal(number, handler)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Signals are noted within the block, and raised as KeyboardInterrupt when it is over."""
        self._held += 1
        try:
            yield
        finally:
            self._held -= 1
        self._check()

    def lead(self, stop_file: Path) -> None:
        """From now on this process waits for others, who end their runs where `stop_file` is; signals make it."""
        self._stop_file, self._leads = stop_file, True
        self._held += 1

    def follow(self, stop_file: Path, leader: int) -> None:
        """From now on this process takes jobs of a sweep, and ends its run where `stop_file` is.

        Nothing is raised here: of an exception between two jobs, joblib kills the runs of all processes. Where this
        process is the child of `leader`, it ends with it.
        """
        if self._stop_file is not None:
            return
        self._stop_file = stop_file
        self._held += 1
        for number in SIGNALS:
            signal.signal(number, self._arrive)
        if os.getppid() == leader:
            self._leader = leader
            end_with(leader)

    def _arrive(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if self._at is None:
            self._at = now
            if self._leads and self._stop_file is not None:
                with suppress(OSError):
                    self._stop_file.touch()
            if self.on_request is not None:
                self.on_request()
        elif now - self._at > SAME_SECONDS:
            self.insisted = True
        self._check()

    def _check(self) -> None:
        if not self.requested:
            return
        if not self._held or (self._leads and self.insisted):
            raise KeyboardInterrupt
        if self._leader is not None and self._held == 1 and os.getppid() != self._leader:
            os._exit(INTERRUPTED)  # between two jobs, and nobody is there to take their outcomes


INTERRUPTION = Interruption()  # of this process
