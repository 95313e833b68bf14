"""A run's process as its job sees it: asked for, waited for, signaled. One starter makes all of a job process."""

from __future__ import annotations

import os
import select
import socket
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from .starter import AHEAD, FORKS, NUMBER, Request, environment_of_starter

CHANGING = ("ENVGS_BENCH_SWEEP", "ENVGS_BENCH_PAGE", "HYDRA_")  # how variables begin that a sweep itself sets


class Starter:
    """The process that starts the runs of this one (`starter.py`), and the socket that it is asked through."""

    def __init__(self, ahead: bool = False) -> None:
        self.surroundings = _surroundings()
        self.channel, other = socket.socketpair()
        told = [AHEAD] if ahead else []
        with other:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-u", "-m", f"{__package__}.starter", str(other.fileno()), *told],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=environment_of_starter(),
                start_new_session=True,  # Ctrl-C reaches this process, which passes it on
                pass_fds=(other.fileno(),),
            )

    @property
    def serves(self) -> bool:
        """Whether it is there, with all that libraries read of the environment as this process has it now."""
        return self.process.poll() is None and self.surroundings == _surroundings()

    def end(self) -> None:
        """End it, where no run of its is under way."""
        self.channel.close()
        self.process.kill()
        self.process.wait()


_starter: Starter | None = None  # of this process


def starter_here(ahead: bool = False) -> Starter:
    """The starter of this process; a new one where there is none, or where libraries would read something else now.

    Args:
        ahead: a new one imports at once what runs need; else when the first fork is asked for.
    """
    global _starter
    if _starter is not None and not _starter.serves:
        _starter.end()
        _starter = None
    if _starter is None:
        _starter = Starter(ahead)
    return _starter


def _surroundings() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith(CHANGING)}


class StartedRun:
    """The process of a run, in a process group of its own that its number names.

    Attributes:
        pid: its number.
        stdout, stderr: what it prints, to be read.
        returncode: how it ended, as of subprocess.Popen; None as long as that is not known.
    """

    def __init__(self, folder: Path, lock: int, environment: Mapping[str, str], handles: tuple[int, ...]) -> None:
        """Start it on the run in `folder`.

        Args:
            lock: the open file of the run's lock, which the process keeps until it ends, and nothing that it starts.
            environment: what its environment has besides this process's.
            handles: other open files that it keeps.

        """
        self._starter = starter_here()
        self.returncode: int | None = None
        outputs = [os.pipe(), os.pipe()]
        ends = tuple(written for _, written in outputs)
        self.stdout, self.stderr = (os.fdopen(read, "rb") for read, _ in outputs)
        try:
            given = {**os.environ, **environment}
            Request(str(folder), os.getcwd(), given, FORKS, (*ends, lock, *handles)).send(self._starter.channel)
        except OSError:
            pass  # it has ended, which is found below
        finally:
            for end in ends:
                os.close(end)
        try:
            number = self._starter.channel.recv(NUMBER.size, socket.MSG_WAITALL)
        except BaseException:  # Ctrl-C where nobody holds it: no run is left that nobody waits for
            self._starter.end()
            raise
        if not number:
            self.returncode = self._starter.process.wait()
        self.pid = NUMBER.unpack(number)[0] if number else self._starter.process.pid

    def poll(self) -> int | None:
        """How it ended, None where it has not."""
        if self.returncode is None:
            try:
                code = self._starter.channel.recv(NUMBER.size, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return None
            # Where nothing comes any more the starter was ended, and the run with it.
            self.returncode = NUMBER.unpack(code)[0] if code else self._starter.process.wait()
        return self.returncode

    def wait(self, seconds: float | None = None) -> int:
        """How it ended, once it has.

        Raises:
            TimeoutError: it did not end within so many seconds.
        """
        if self.returncode is None:
            poll = select.poll()
            poll.register(self._starter.channel, select.POLLIN)
            poll.poll(None if seconds is None else 1000 * seconds)
        if (code := self.poll()) is None:
            raise TimeoutError
        return code

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)
