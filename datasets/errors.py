"""What a data source raises, and how it names files in a message."""

from __future__ import annotations

MAX_LISTED = 5  # files named in a message


class DatasetError(ValueError):
    """The data cannot be used: the message names the file or key and says what to do."""


def listed(names: list[str]) -> str:
    """The first few names, for a message."""
    return ", ".join(names[:MAX_LISTED]) + (" …" if len(names) > MAX_LISTED else "")
