"""Locks on open files, as Linux and macOS have them; a system without is told of when one is needed, not before."""

from __future__ import annotations

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
