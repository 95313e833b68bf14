"""Starter: a process that imports what a run imports, and forks a run's process whenever its job asks for one.

`python -m envgs_bench.runs.starter <socket>`, started by the process whose jobs it serves (`started_run.py`), which it
ends with. It imports before its first fork, or at once where it is told to. Of a request it makes a run's process, says
its number, and says how it ended, one after the other. A fork costs a hundredth of the imports. No GPU is looked at
here: a process that has done so can fork none that uses one.
"""

from __future__ import annotations

import ctypes
import gc
import importlib
import json
import os
import socket
import struct
import sys
import traceback
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from .processes import JOB_VARIABLE, LOCK_VARIABLE, RUN_VARIABLE, end_with

# A fork of a program with threads may wait for a lock forever. Only Linux' libraries start none as they are loaded, but
# for OpenBLAS, which ends its own before a fork.
FORKS = sys.platform == "linux"
WORKER = f"{__package__}.worker"
AHEAD = "ahead"  # the argument with which it imports before anybody asks
# What most runs import beyond the worker, as they come to it.
IMPORTED = (WORKER, "scipy.spatial", "scipy.ndimage", "kornia.color", "skimage.metrics", "PIL.PngImagePlugin")
ROOM = 4096  # bytes of the longest path: what the environment keeps free for the run's folder
ENV_START, ENV_END = 47, 48  # in /proc/self/stat, counted from the field behind the program's name (Linux' proc(5))
NUMBER = struct.Struct("q")


@dataclass(frozen=True)
class Request:
    """A run's process to be started.

    Attributes:
        folder: the run's, as it is to be written into the environment.
        directory: the working directory.
        environment: all of it.
        forked: whether it is a fork that has imported all, or a program that begins anew.
        handles: open files: standard output, standard error, the run's lock, and what else the process keeps.
    """

    folder: str
    directory: str
    environment: dict[str, str]
    forked: bool
    handles: tuple[int, ...]

    def send(self, channel: socket.socket) -> None:
        content = json.dumps([self.folder, self.directory, self.environment, self.forked]).encode()
        socket.send_fds(channel, [NUMBER.pack(len(content))], list(self.handles))
        channel.sendall(content)

    @classmethod
    def received(cls, channel: socket.socket) -> Request | None:
        """The next request; None where nobody is there to ask any more."""
        length, handles, _, _ = socket.recv_fds(channel, NUMBER.size, 16, socket.MSG_WAITALL)
        if not length:
            return None
        content = channel.recv(NUMBER.unpack(length)[0], socket.MSG_WAITALL)
        folder, directory, environment, forked = json.loads(content)
        return cls(folder, directory, environment, forked, tuple(handles))


def main(arguments: list[str]) -> int:
    """Serve the process at the other end of the socket of this number until it is gone."""
    end_with(int(os.environ[JOB_VARIABLE]))
    channel = socket.socket(fileno=int(arguments[0]))
    channel.set_inheritable(False)
    if FORKS and AHEAD in arguments:
        _import_all()
    while (request := Request.received(channel)) is not None:
        if request.forked:
            _import_all()
        starter, number = os.getpid(), os.fork()
        if not number:
            channel.close()
            _become(request, starter)
        with suppress(OSError):  # it did so itself, or has ended
            os.setpgid(number, number)
        for handle in request.handles:
            os.close(handle)
        channel.sendall(NUMBER.pack(number))
        _, status = os.waitpid(number, 0)
        channel.sendall(NUMBER.pack(os.waitstatus_to_exitcode(status)))
    return 0


def _import_all() -> None:
    """Import what runs need, once. What fails here fails in the run as well, whose log says why."""
    if WORKER in sys.modules:
        return
    for name in IMPORTED:
        with suppress(Exception):
            importlib.import_module(name)
    with suppress(Exception):
        importlib.import_module(f"{__package__}.provenance").checkout()
    gc.collect()
    gc.freeze()  # a collection in a fork would copy each page that it marks


def _become(request: Request, starter: int) -> NoReturn:
    """Be the process of a run: this fork, or a program that begins anew."""
    try:
        with suppress(OSError):
            os.setpgid(0, 0)
        out, err, lock, *_ = request.handles
        for handle, standard in ((out, 1), (err, 2)):
            os.dup2(handle, standard)
            os.close(handle)
        os.chdir(request.directory)
        own = {RUN_VARIABLE: request.folder, JOB_VARIABLE: str(starter), LOCK_VARIABLE: str(lock)}
        os.environ.clear()
        os.environ.update(request.environment | own)
        if not request.forked:
            for handle in request.handles[2:]:
                os.set_inheritable(handle, True)
            os.execv(sys.executable, [sys.executable, "-P", "-u", "-m", WORKER, request.folder])
        _show(request.folder)
        worker: Any = importlib.import_module(WORKER)
        worker.leave(worker.main([request.folder]), Path(request.folder))
    except BaseException:
        traceback.print_exc()
    os._exit(1)


def _show(folder: str) -> None:
    """Have /proc/<number>/environ show the run's folder: others find a run's processes by it, those that forked too.

    It shows the memory that the starter's environment was put into, where `environment_of_starter` left room.
    """
    fields = Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    start, end = int(fields[ENV_START]), int(fields[ENV_END])
    room = f"{RUN_VARIABLE}={'-' * ROOM}".encode()
    at = start + ctypes.string_at(start, end - start).index(room)
    ctypes.memmove(at, f"{RUN_VARIABLE}={folder}".encode().ljust(len(room), b"\0"), len(room))


def environment_of_starter() -> dict[str, str]:
    """The environment of the starter of this process's jobs."""
    return {**os.environ, JOB_VARIABLE: str(os.getpid()), RUN_VARIABLE: "-" * ROOM}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
