"""Names of files as data files give them: they must stay below the data's folder."""

from __future__ import annotations

import os
import posixpath
import unicodedata
from pathlib import Path, PurePosixPath

from ..errors import DatasetError

PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")  # extensions of photographs, in small letters
EXTENSIONS = (*PICTURES, ".gif", ".ppm", ".pgm", ".pbm", ".npy")  # and of what lies beside them
HIDDEN = ("__MACOSX", "Thumbs.db", "desktop.ini")
LONGEST_NAME = 240  # bytes of a part: file systems end it at 255, and sidecar files' names add some
LONGEST_PATH = 2000  # characters of the whole


def path_below(folder: Path, name: str, source: Path) -> Path:
    """`folder/name`, where `source`, a file or folder, is what names it.

    Where Unicode spells the name in two ways, composed or not, it is spelled as it is there.
    Links are followed: they are the user's own doing, a name in somebody's data is not.

    Raises:
        DatasetError: the name is absolute, climbs out of the folder, or is longer than a file's can be.
    """
    clean = clean_name(name, source)
    path = folder / clean
    if clean.isascii() or path.exists():
        return path
    for part in clean.split("/"):
        folder = _child(folder, part)
    return folder


def composed(name: str) -> str:
    """The name in the one of Unicode's spellings that comparisons use: file systems and programs mix them."""
    return unicodedata.normalize("NFC", name)


def stem_of(name: str) -> str:
    """The name without the extension of a picture or an array; another dot's part belongs to it, as of `t_0.25`."""
    return str(PurePosixPath(name).with_suffix("")) if PurePosixPath(name).suffix.lower() in EXTENSIONS else name


def visible_files(folder: Path, deep: bool = True) -> list[Path]:
    """The files below the folder, sorted, without what programs hide there: `._x.png`, `.thumbnails/`, `__MACOSX/`."""
    files = [path for path in (folder.rglob("*") if deep else folder.glob("*")) if path.is_file()]
    return sorted(path for path in files if not _is_hidden(path.relative_to(folder)))


def _is_hidden(path: Path) -> bool:
    return any(part.startswith(".") or part in HIDDEN for part in path.parts)


def _child(folder: Path, part: str) -> Path:
    """The file or folder of this name, or else the one that differs in its spelling alone."""
    if (folder / part).exists() or not folder.is_dir():
        return folder / part
    alike = [path for path in folder.iterdir() if composed(path.name) == composed(part)]
    return alike[0] if len(alike) == 1 else folder / part


def clean_name(name: str, source: Path) -> str:
    """The name without `.` and `..`, `/` between its parts; raises as `path_below`."""
    parts = name.replace("\\", "/").split("/")
    if "\0" in name or len(name) > LONGEST_PATH or max(len(os.fsencode(part)) for part in parts) > LONGEST_NAME:
        raise DatasetError(f"{source}: names a file {name[:60]!r}… of {len(name)} characters, which no file is called")
    clean = posixpath.normpath("/".join(parts))
    if clean.startswith(("/", "../")) or clean == ".." or clean[1:2] == ":":
        raise DatasetError(f"{source}: names a file outside its folder, {name!r}; write paths relative to the folder")
    return clean
