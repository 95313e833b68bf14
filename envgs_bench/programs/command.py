"""Command: one command of another program, from its start to its end, whichever that is."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO

import psutil

from .isolation import Started, executable
from .memory import MemoryWatch, ProgramOutOfMemory

LOOK_SECONDS = 0.2
GRACE_SECONDS = 5.0  # how long it may take to end once it is asked to
DRAIN_SECONDS = 2.0  # how long what it printed may take to be read once it is gone
QUOTED_LINES = 12
LONGEST_LINE = 4096
OUT_OF_MEMORY = re.compile(r"out of memory|MemoryError|OutOfMemory|std::bad_alloc|can't allocate memory", re.IGNORECASE)


class ProgramFailed(RuntimeError):
    """The program could not be started, or ended with a failure; the message says how, and what it printed last."""


def run_command(
    started: Started,
    folder: Path,
    watch: MemoryWatch,
    listen: Callable[[str], None] = lambda line: None,
    tell: Callable[[], None] = lambda: None,
) -> None:
    """Run the command in `folder` to its end; what it prints goes to standard error.

    Whatever is raised here or asked for by a signal, the command and all that it started are ended first.

    Args:
        listen: is given every line that it prints, in another thread.
        tell: is called now and then, in this one.

    Raises:
        ProgramFailed: it cannot be started, or its exit status is not 0.
        ProgramOutOfMemory: it passed a limit, was killed, or says that memory ran out.
    """
    shown = " ".join(started.words)
    if executable(started) is None:
        raise ProgramFailed(f"{started.words[0]}: there is no such program on the PATH; the command was: {shown}")
    print(f"$ {shown}", file=sys.stderr, flush=True)
    try:
        process = subprocess.Popen(
            started.words,
            cwd=folder,
            env={**os.environ, **started.environment},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except OSError as error:
        raise ProgramFailed(f"{started.words[0]}: cannot be started ({error}); the command was: {shown}") from error
    assert process.stdout is not None
    reader = _Reader(process.stdout, listen)
    reader.start()
    pid = None if started.container else process.pid
    try:
        while process.poll() is None:
            watch.look(pid)
            tell()
            with suppress(subprocess.TimeoutExpired):
                process.wait(LOOK_SECONDS)
        reader.join(DRAIN_SECONDS)
    finally:
        _end(process, started)
        reader.join(DRAIN_SECONDS)
        tell()
    if process.returncode:
        raise _failure(process.returncode, shown, list(reader.last))


class _Reader(threading.Thread):
    """Passes on what a program prints, and keeps its last lines; a progress bar's \\r ends a line too."""

    def __init__(self, stream: IO[bytes], listen: Callable[[str], None]) -> None:
        super().__init__(daemon=True)
        self._stream, self._listen = stream, listen
        self.last: deque[str] = deque(maxlen=QUOTED_LINES)

    def run(self) -> None:
        unread = b""
        while chunk := self._read():
            with suppress(OSError):
                os.write(2, chunk)
            *lines, unread = re.split(rb"[\r\n]", (unread + chunk)[-(1 << 20) :])
            for line in lines:
                self._take(line)
        self._take(unread)

    def _read(self) -> bytes:
        try:
            return os.read(self._stream.fileno(), 1 << 16)
        except (OSError, ValueError):
            return b""

    def _take(self, content: bytes) -> None:
        line = content[:LONGEST_LINE].decode(errors="replace")
        if line.strip():
            self.last.append(line)
            with suppress(Exception):  # what a program prints never ends a run
                self._listen(line)


def _end(process: subprocess.Popen[bytes], started: Started) -> None:
    """See to it that nothing of it is left: asked first, then killed, with what left its group too."""
    children: list[psutil.Process] = []
    with suppress(psutil.Error):
        children = psutil.Process(process.pid).children(recursive=True)
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(GRACE_SECONDS)
    for child in children:
        with suppress(psutil.Error):
            child.kill()
    with suppress(OSError, subprocess.SubprocessError):
        started.remove_container()


def _failure(code: int, command: str, last: list[str]) -> Exception:
    quoted = "\n".join(["it printed last:", *last]) if last else "it printed nothing"
    if code == -signal.SIGKILL or (code == 128 + signal.SIGKILL):
        return ProgramOutOfMemory(f"was killed (SIGKILL): most often the system ran out of memory; {command}\n{quoted}")
    how = f"ended with exit status {code}" if code > 0 else f"died of {signal.Signals(-code).name}"
    if OUT_OF_MEMORY.search("\n".join(last)):
        return ProgramOutOfMemory(f"{how}, out of memory: {command}\n{quoted}")
    return ProgramFailed(f"{how}: {command}\n{quoted}")


def environment_on(device: str, variables: Mapping[str, str]) -> dict[str, str]:
    """The program's variables; one that is to compute on the CPU sees no GPU."""
    return {**({"CUDA_VISIBLE_DEVICES": ""} if device == "cpu" else {}), "PYTHONUNBUFFERED": "1", **variables}
