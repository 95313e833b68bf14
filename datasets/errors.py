"""What a data source raises, and how it names files in a message."""

from __future__ import annotations

NAMED_AT_MOST = 5  # files in a message


class DatasetError(ValueError):
    """The data cannot be used: the message names the file or key and says what to do."""


def listed(names: list[str]) -> str:
    """The first few names, for a message."""
    return ", ".join(names[:NAMED_AT_MOST]) + (" …" if len(names) > NAMED_AT_MOST else "")
