"""COLMAP's text models as other programs write them, where pycolmap's reader would stop or take something else."""

from __future__ import annotations

import codecs
from pathlib import Path

from envgs_bench.regular_file import require_regular

MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


def begins_with_mark(path: Path) -> bool:
    """Whether the file begins with a byte order mark, which pycolmap takes for a part of the first line."""
    return _encoding(path) != "utf-8"


def without_mark(path: Path) -> str:
    """The file's text, whatever Unicode it is stored as.

    Raises:
        OSError, UnicodeDecodeError: it is no regular file, or holds no text.
    """
    return path.read_text(encoding=_encoding(path))


def image_names(path: Path) -> dict[int, str]:
    """The names in an images.txt by their images' ids; spaces within a name are its own, which pycolmap ends it at.

    An image has two lines: nine numbers and its name, then its points, a line that may be empty.

    Raises:
        OSError, ValueError, IndexError: it is no such file.
    """
    require_regular(path)
    names = {}
    with path.open(encoding=_encoding(path)) as lines:
        for line in lines:
            if line.strip() and not line.startswith("#"):
                words = line.split(maxsplit=9)
                names[int(words[0])] = words[9].rstrip()
                next(lines, None)
    return names


def _encoding(path: Path) -> str:
    with path.open("rb") as stream:
        begin = stream.read(3)
    return next((name for mark, name in MARKS.items() if begin.startswith(mark)), "utf-8")
