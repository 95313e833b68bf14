"""Locks on open files, as Linux and macOS have them; a system without is told of when one is needed, not before."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

PATIENCE = 0.5  # seconds until a process that waits for another one looks again


def lock(handle: int, shared: bool = False) -> None:
    """Lock the open file until all processes that have it open close it, or end.

    Raises:
        BlockingIOError: somebody else has it locked.
        OSError: this system has no such locks.
    """
    if fcntl is None:
        raise OSError("runs need file locks as of Linux or macOS; on Windows use the Windows Subsystem for Linux")
    fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)


def locked_file(path: Path) -> int | None:
    """The file, made where there is none, open and locked; None where somebody else has it locked.

    Give it back by `removed`: a file is unlinked while it is locked, and who finds that one takes the next.

    Raises:
        OSError: it cannot be written, or this system has no such locks.
    """
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NONBLOCK | os.O_NOFOLLOW, 0o644)
        try:
            lock(handle)
        except BlockingIOError:
            os.close(handle)
            return None
        except BaseException:
            os.close(handle)
            raise
        try:
            if os.fstat(handle).st_ino == os.stat(path).st_ino:
                return handle
        except FileNotFoundError:
            pass
        os.close(handle)  # its last holder removed it between the two calls


def removed(path: Path, handle: int) -> None:
    """Give back what `locked_file` opened: the file is gone, and the lock with it."""
    with suppress(OSError):
        path.unlink()
    os.close(handle)


@contextmanager
def one_at_a_time(path: Path, waiting: Callable[[], object] = lambda: None) -> Iterator[None]:
    """A block that one process is in at a time, of those that share the lock file `path`; the others wait.

    A lock ends with its process. Where there can be none, as nothing can be written there, nobody waits.

    Args:
        waiting: called whenever another process is found in the block.
    """
    handle = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        while (handle := locked_file(path)) is None:
            waiting()
            time.sleep(PATIENCE)
    except OSError:
        pass
    try:
        yield
    finally:
        if handle is not None:
            removed(path, handle)
