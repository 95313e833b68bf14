"""Threads: how many the backend works with, and how many torch's own operations take beside it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import torch

_before: ContextVar[int | None] = ContextVar("threads that torch had before torch_on_one_thread", default=None)


def workers() -> int:
    """How many threads the backend takes: torch's, or within `torch_on_one_thread` those that torch had before."""
    return _before.get() or torch.get_num_threads()


@contextmanager
def torch_on_one_thread() -> Iterator[None]:
    """In here torch's own operations take one thread and the backend as many as torch had.

    A thread that sleeps while it waits takes longer to wake than a small operation takes altogether, and an image of
    a hundred pixels' width is a thousand small operations.
    """
    threads = torch.get_num_threads()
    token = _before.set(workers())
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        _before.reset(token)
