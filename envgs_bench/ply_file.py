"""PLY files, read by plyfile once their header is known to promise no more than the file can hold."""

from __future__ import annotations

from pathlib import Path

from plyfile import PlyData, PlyElement, PlyListProperty

from .regular_file import require_regular

MOST_HEADER_BYTES = 1 << 20


def read_elements(path: Path) -> dict[str, PlyElement]:
    """The elements of the file, by name.

    Raises:
        ValueError: it cannot be read, or is no PLY; the message names it.
    """
    try:
        size = require_regular(path)
        _check_counts(path, size)
        return {element.name: element for element in PlyData.read(str(path)).elements}
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    except Exception as error:  # plyfile raises whatever foreign bytes lead it to
        raise ValueError(f"{path}: is no readable PLY ({error}); export it again") from error


def number_names(element: PlyElement) -> list[str]:
    """The properties that hold a number a row, not a list."""
    return [item.name for item in element.properties if not isinstance(item, PlyListProperty)]


def _check_counts(path: Path, size: int) -> None:
    """plyfile makes room for as many rows as the header says, and NumPy divides by their bytes: each takes some."""
    with path.open("rb") as stream:
        lines = [line.split() for line in stream.read(MOST_HEADER_BYTES).splitlines()]
    bare = None  # an element that no property was named of yet
    for words in lines:
        kind = words[0] if words else b""
        if bare is not None and kind in (b"element", b"end_header"):
            raise ValueError(f"its header does not say what a row of {bare} holds")
        if kind == b"end_header":
            break
        if kind == b"property":
            bare = None
        elif kind == b"element" and len(words) == 3:
            bare, count = (word.decode("ascii", "replace") for word in words[1:])
            if not count.isdecimal() or int(count) > size:
                raise ValueError(f"its header promises {count[:40]} rows of {bare}, the file has {size:,} bytes")
    else:
        raise ValueError(f"it has no end_header within {MOST_HEADER_BYTES:,} bytes")
