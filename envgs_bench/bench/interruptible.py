"""Interruptible: a benchmark that is ended early prints and keeps what it has measured."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

from envgs_bench.stages.stop import INTERRUPTED


class Ending:
    """How the block of `interruptible` ended; `status` is the exit status that says so."""

    status = 0


@contextmanager
def interruptible() -> Iterator[Ending]:
    """Ctrl-C and SIGTERM, which `timeout` and job schedulers send, end the block and nothing else."""
    ending = Ending()
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield ending
    except KeyboardInterrupt:
        ending.status = INTERRUPTED
    finally:
        signal.signal(signal.SIGTERM, before)
