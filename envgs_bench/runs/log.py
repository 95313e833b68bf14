"""Log: what a run printed, its head and its tail, however much it was."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import IO

from envgs_bench.run_folder import LOG_NAME

HEAD_BYTES = 512 * 1024
TAIL_BYTES = 512 * 1024
CHUNK_BYTES = 64 * 1024

QUOTED_LINES = 30
QUOTED_BYTES = 8 * 1024
MESSAGE_BYTES = 4 * 1024


class BoundedLog(threading.Thread):
    """Reads `stream` to its end and keeps of it, in log.txt of `folder`, the head and the tail.

    Whatever happens to the file, a full disk or a deleted folder, the stream is read: nobody blocks who writes to it.
    A log that is there already is continued.
    """

    def __init__(self, stream: IO[bytes], folder: Path) -> None:
        super().__init__(daemon=True)
        self._stream = stream
        path = folder / LOG_NAME
        if path.is_symlink() or (path.exists() and not path.is_file()):
            path.unlink()  # neither through a link nor into a pipe
        self._file: int | None = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        self._room = HEAD_BYTES - min(os.fstat(self._file).st_size, HEAD_BYTES // 2)
        self._tail = bytearray()
        self._left_out = 0

    def run(self) -> None:
        try:
            while chunk := os.read(self._stream.fileno(), CHUNK_BYTES):
                self._take(chunk)
        except (OSError, ValueError):
            pass  # closed by `finish`

    def finish(self, seconds: float) -> None:
        """Wait for the stream's end, `seconds` at most, and write the tail."""
        self.join(seconds)
        tail = bytes(self._tail[-TAIL_BYTES:])
        left_out = self._left_out + len(self._tail) - len(tail)
        if left_out:
            self._write(f"\n[… {left_out:,} bytes are left out here …]\n".encode())
        self._write(tail)
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _take(self, chunk: bytes) -> None:
        head, rest = chunk[: self._room], chunk[self._room :]
        self._room -= len(head)
        self._write(head)
        self._tail += rest
        if len(self._tail) > 4 * TAIL_BYTES:
            self._left_out += len(self._tail) - TAIL_BYTES
            del self._tail[:-TAIL_BYTES]

    def _write(self, content: bytes) -> None:
        while content and self._file is not None:
            try:
                content = content[os.write(self._file, content) :]
            except OSError:
                return


def log_tail(folder: Path) -> str:
    """The last lines of the run's log, QUOTED_BYTES of them at most; "" where there is none."""
    path = folder / LOG_NAME
    if not path.is_file():
        return ""
    try:
        with path.open("rb") as log:
            log.seek(-min(path.stat().st_size, 2 * QUOTED_BYTES), os.SEEK_END)
            lines = log.read(2 * QUOTED_BYTES).decode(errors="replace").splitlines(keepends=True)
    except OSError:
        return ""
    return shortened("".join(lines[-QUOTED_LINES:]), QUOTED_BYTES)


def shortened(text: str, most: int = MESSAGE_BYTES) -> str:
    """`text`, or its head and its tail where it is longer than `most` bytes in UTF-8."""
    content = text.encode(errors="replace")
    if len(content) <= most:
        return text
    head, tail = content[: most // 2].decode(errors="ignore"), content[-(most // 2) :].decode(errors="ignore")
    return f"{head} [… {len(content) - most:,} bytes …] {tail}"
