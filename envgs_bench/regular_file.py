"""Regular files: all that readers open. A pipe in a file's place would be waited for without end, or read so."""

from __future__ import annotations

import stat
from pathlib import Path

KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def require_regular(path: Path, most_bytes: int | None = None) -> int:
    """The size in bytes of the file at `path`, which may be a link to one.

    Args:
        most_bytes: what such a file may hold.

    Raises:
        OSError: there is none, it is something else than a file, or larger; the message does not name it.
    """
    try:
        status = path.stat()
    except ValueError as error:  # a name with a NUL
        raise OSError(str(error)) from error
    if not stat.S_ISREG(status.st_mode):
        raise OSError(f"it is {KINDS.get(stat.S_IFMT(status.st_mode), 'no file')}, expected a file")
    if most_bytes is not None and status.st_size > most_bytes:
        raise OSError(f"it has {status.st_size:,} bytes, more than the {most_bytes:,} that such a file may have")
    return status.st_size


def read_regular_text(path: Path, most_bytes: int) -> str:
    """The UTF-8 text of the file, without the byte order mark that editors on Windows begin it with.

    Raises:
        OSError: as `require_regular`, or it cannot be read.
        UnicodeDecodeError: it is no such text.
    """
    require_regular(path, most_bytes)
    return path.read_text(encoding="utf-8-sig")
