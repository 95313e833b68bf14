"""Listing: which files a source of photographs makes its scene from, asked without making it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextvars import ContextVar
from pathlib import Path

_asked: ContextVar[bool] = ContextVar("asked", default=False)


class _Listed(Exception):
    """Ends the source's work where it knows its files."""

    def __init__(self, files: list[Path]) -> None:
        super().__init__()
        self.files = files


def listed_files(load: Callable[[], object]) -> list[Path] | None:
    """The files that `load` names in `name_files`, without what it does afterwards; None where it names none."""
    token = _asked.set(True)
    try:
        load()
    except _Listed as listed:
        return listed.files
    finally:
        _asked.reset(token)
    return None


def name_files(files: Iterable[Path]) -> list[Path]:
    """The files of these that are there: all that a scene is made from, to be called before it is made."""
    found = [path for path in files if path.is_file()]
    if _asked.get():
        raise _Listed(found)
    return found
