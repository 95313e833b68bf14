"""Background: what a CPU does beside a GPU: pictures are compressed and models packed while others are drawn."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import ParamSpec, TypeVar

import torch

MOST_THREADS = 8
UNDER_WAY = 16  # pieces of work at most: each may hold a picture and its layers, 0.1 GB at 1000×1000

Given = ParamSpec("Given")
Result = TypeVar("Result")


class Background:
    """A context for work that need not be waited for; leaving it waits for all of it, and raises what it raised.

    Only work that lets go of Python's lock gains. Where a CPU draws, it has no time to spare: work is done at once.

    Args:
        device: what draws.
    """

    def __init__(self, device: torch.device) -> None:
        threads = min(MOST_THREADS, os.cpu_count() or 1)
        self._pool = ThreadPoolExecutor(threads) if device.type == "cuda" else None
        self._under_way: deque[Future] = deque()

    def __enter__(self) -> Background:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            while self._under_way and error is None:
                self._under_way.popleft().result()
        finally:
            if self._pool is not None:
                self._pool.shutdown(cancel_futures=True)

    def begin(self, work: Callable[Given, Result], *args: Given.args, **options: Given.kwargs) -> Future[Result]:
        """Begin this work; what it returns. Waits for the oldest of UNDER_WAY, and raises what that raised."""
        if self._pool is None:
            done: Future[Result] = Future()
            done.set_result(work(*args, **options))
            return done
        while len(self._under_way) >= UNDER_WAY:
            self._under_way.popleft().result()
        future = self._pool.submit(work, *args, **options)
        self._under_way.append(future)
        return future
