"""Names of files as data files give them: they must stay below the data's folder."""

from __future__ import annotations

import posixpath
from pathlib import Path

from ..errors import DatasetError


def path_below(folder: Path, name: str, source: Path) -> Path:
    """`folder/name`, where `source`, a file or folder, is what names it.

    Links are followed: they are the user's own doing, a name in somebody's data is not.

    Raises:
        DatasetError: the name is absolute or climbs out of the folder.
    """
    return folder / clean_name(name, source)


def clean_name(name: str, source: Path) -> str:
    """The name without `.` and `..`, `/` between its parts; raises as `path_below`."""
    clean = posixpath.normpath(name.replace("\\", "/"))
    if clean.startswith(("/", "../")) or clean == ".." or clean[1:2] == ":":
        raise DatasetError(f"{source}: names a file outside its folder, {name!r}; write paths relative to the folder")
    return clean
