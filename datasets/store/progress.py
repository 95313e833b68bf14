"""Progress: what a data source is doing, for whoever shows it, and what it noticed, for the log."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
Listener = Callable[[str, int, int], None]  # what is being done, how many of it are, of how many

log = logging.getLogger("envgs_bench.datasets")

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
    results: list[Result] = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for result in pool.map(function, items):
            results.append(result)
            report(stage, len(results), len(items))
    return results
