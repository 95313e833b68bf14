"""Run lock: who is at a run's folder at this moment, and how far it has come. One file, locked while somebody is."""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from envgs_bench.file_lock import lock, locked_file, removed

LOCK_NAME = "lock.json"
MOST_BYTES = 65_536  # a lock file that is longer was not written here


@dataclass(frozen=True)
class Holder:
    """The process that locked a folder, as it wrote it down itself."""

    host: str = ""
    pid: int = 0
    started: float = 0.0  # when the process started, Unix time: its number may be given again
    since: float = 0.0  # when it locked the folder, Unix time
    progress: dict[str, Any] = field(default_factory=dict)  # its run's last event, and "at", the event's Unix time

    @property
    def is_here(self) -> bool:
        return self.host == socket.gethostname()

    @property
    def is_gone(self) -> bool:
        """Whether it ran on this machine and runs no more: what still holds the lock are processes it left."""
        return self.is_here and _start_of(self.pid) != self.started

    def __str__(self) -> str:
        if not self.pid:
            return "another process"
        return f"process {self.pid}" + ("" if self.is_here else f" on {self.host}")


class RunLock:
    """A lock on a run's folder that this process holds."""

    def __init__(self, handle: int) -> None:
        self.handle = handle  # of the locked file: the lock lasts as long as any process has it open
        self._holder = {
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "started": _start_of(os.getpid()),
            "since": time.time(),
        }
        self.note({})

    def note(self, progress: dict[str, Any]) -> None:
        """Write down how far the run has come, for whoever asks. Where that cannot be written, nothing is lost."""
        content = json.dumps({**self._holder, "progress": {**progress, "at": time.time()}}).encode()
        with suppress(OSError):
            os.pwrite(self.handle, content, 0)
            os.ftruncate(self.handle, len(content))


@contextmanager
def locked(folder: Path) -> Iterator[RunLock | None]:
    """The lock on `folder`, or None where somebody else has it.

    It ends with the block, or with this process and those that were given `RunLock.handle`. Several machines may share
    the folder where their file system locks files for all of them (flock, as NFS does since version 4).

    Raises:
        OSError: the folder cannot be written to.
    """
    path = folder / LOCK_NAME
    handle = locked_file(path)
    if handle is None:
        yield None
        return
    try:
        yield RunLock(handle)
    finally:
        removed(path, handle)


def holder_of(folder: Path) -> Holder | None:
    """Who holds the lock on `folder`, None where nobody does."""
    path = folder / LOCK_NAME
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
    except OSError:
        return None
    try:
        lock(handle, shared=True)
    except BlockingIOError:
        return _read(handle)
    except OSError:
        return None
    finally:
        os.close(handle)
    return None


def _read(handle: int) -> Holder:
    try:
        content = json.loads(os.pread(handle, MOST_BYTES, 0))
        return Holder(**content)
    except (OSError, ValueError, TypeError, RecursionError):
        return Holder()  # it is being written


def _start_of(pid: int) -> float:
    """When the process started, 0 where there is none, or only what is left of one."""
    try:
        process = psutil.Process(pid)
        return 0.0 if process.status() == psutil.STATUS_ZOMBIE else process.create_time()
    except psutil.Error:
        return 0.0
