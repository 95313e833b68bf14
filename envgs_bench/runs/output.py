"""Output: printing that never raises. A sweep goes on where its terminal, its pipe or the log's disk does not."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO, cast


class Unbreakable:
    """A stream that drops what cannot be written; a pipe that nobody reads any more is not tried again."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        try:
            self._stream.write(text)
        except UnicodeEncodeError:
            self.write(text.encode(self._stream.encoding, errors="replace").decode(self._stream.encoding))
        except (OSError, ValueError) as error:
            self._give_up(error)
        return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except (OSError, ValueError) as error:
            self._give_up(error)

    def close_quietly(self) -> None:
        """Flush for the last time; what cannot be written is dropped, lest the interpreter raise at its end."""
        try:
            self._stream.flush()
        except (OSError, ValueError):
            self._to_nowhere()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _give_up(self, error: Exception) -> None:
        if isinstance(error, BrokenPipeError):
            self._to_nowhere()

    def _to_nowhere(self) -> None:
        with suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)
            self._stream.flush()


@contextmanager
def unbreakable_output() -> Iterator[None]:
    """Within the block, neither sys.stdout nor sys.stderr raises."""
    before = sys.stdout, sys.stderr
    if isinstance(sys.stderr, Unbreakable):
        yield
        return
    streams = [Unbreakable(stream) for stream in before]
    sys.stdout, sys.stderr = (cast(TextIO, stream) for stream in streams)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
        for stream in streams:
            stream.close_quietly()
