"""Progress: how far a data source has come, for whoever shows it, and work on all cores that says so."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
Listener = Callable[[str, int, int], None]  # what is being done, how many of it are, of how many

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Within the block, data sources tell `listener` how far they have come."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def report(stage: str, done: int, total: int) -> None:
    """Tell whoever listens that `done` of `total` are done."""
    listener = _listener.get()
    if listener is not None:
        listener(stage, done, total)


def mapped(stage: str, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """`function` of every item, in their order, on all cores; reports each as it is done.

    The first exception ends it.
    """
    return list(streamed(stage, function, items))


def streamed(
    stage: str, function: Callable[[Item], Result], items: Sequence[Item], cores: int | None = None
) -> Iterator[Result]:
    """As `mapped`, one result after the other, on so many cores; work begins with the first that is asked for.

    No more than two results a core are ever waiting to be taken, so that they need not fit into memory together.
    """
    cores = cores or os.cpu_count() or 1
    pool = ThreadPoolExecutor(cores)
    waiting: deque[Future[Result]] = deque()
    begun = 0
    try:
        for taken in range(len(items)):
            while begun < min(taken + 2 * cores, len(items)):
                waiting.append(pool.submit(function, items[begun]))
                begun += 1
            result = waiting.popleft().result()
            report(stage, taken + 1, len(items))
            yield result
    finally:
        pool.shutdown(cancel_futures=True)
