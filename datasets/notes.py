"""Notes: what a data source noticed about the data, for the log."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_log = logging.getLogger("envgs_bench.datasets")

_collected: ContextVar[list[str] | None] = ContextVar("collected", default=None)


def note(text: str) -> None:
    """Have the log say `text`; within `collecting`, it is also put down."""
    _log.warning(text)
    collected = _collected.get()
    if collected is not None:
        collected.append(text)


@contextmanager
def collecting() -> Iterator[list[str]]:
    """A list of what is noted within the block, as it grows: whoever keeps a scene keeps what was noted of it.

    A block around this one has it at its end.
    """
    notes: list[str] = []
    around = _collected.get()
    token = _collected.set(notes)
    try:
        yield notes
    finally:
        _collected.reset(token)
        if around is not None:
            around.extend(notes)
