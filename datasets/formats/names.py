"""Names of files as data files give them: they must stay below the data's folder."""

from __future__ import annotations

import os
import posixpath
from pathlib import Path

from ..errors import DatasetError

LONGEST_NAME = 240  # bytes of a part: file systems end it at 255, and siblings' names add some
LONGEST_PATH = 2000  # characters of the whole


def path_below(folder: Path, name: str, source: Path) -> Path:
    """`folder/name`, where `source`, a file or folder, is what names it.

    Links are followed: they are the user's own doing, a name in somebody's data is not.

    Raises:
        DatasetError: the name is absolute, climbs out of the folder, or is longer than a file's can be.
    """
    return folder / clean_name(name, source)


def clean_name(name: str, source: Path) -> str:
    """The name without `.` and `..`, `/` between its parts; raises as `path_below`."""
    parts = name.replace("\\", "/").split("/")
    if "\0" in name or len(name) > LONGEST_PATH or max(len(os.fsencode(part)) for part in parts) > LONGEST_NAME:
        raise DatasetError(f"{source}: names a file {name[:60]!r}… of {len(name)} characters, which no file is called")
    clean = posixpath.normpath("/".join(parts))
    if clean.startswith(("/", "../")) or clean == ".." or clean[1:2] == ":":
        raise DatasetError(f"{source}: names a file outside its folder, {name!r}; write paths relative to the folder")
    return clean
