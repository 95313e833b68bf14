"""Locks on open files, as Linux and macOS have them; a system without is told of when one is needed, not before."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


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
