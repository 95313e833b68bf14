"""What a data source raises, and how it names files in a message."""

from __future__ import annotations

MAX_LISTED = 5  # files named in a message


class DatasetError(ValueError):
    """The data cannot be used: the message names the file or key and says what to do."""


def unwritable(folder: object, error: OSError, what: str, lacking: str) -> str:
    """Why a cache in `folder` that cannot be written will not do, and what to do.

    Args:
        folder: as the user is to see it named.
        what: would have to be written.
        lacking: what is not there of it.
    """
    return (
        f"{folder}: cannot be written ({error.strerror}), and {what} would have to be: {lacking} is not there yet. "
        "Give a folder that can be written as cache_dir=, or set ENVGS_BENCH_CACHE to one"
    )


def listed(names: list[str]) -> str:
    """The first few names, for a message."""
    return ", ".join(names[:MAX_LISTED]) + (" …" if len(names) > MAX_LISTED else "")
