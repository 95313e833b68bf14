"""How a command ends whose input cannot be used."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from envgs_bench.pages import FAILED, help_at, help_on
from envgs_bench.plain_text import plain


def explained(command: str, work: Callable[[], int], out: Path | None = None) -> int:
    """The exit status of `work`; 1 with the explanation on standard error where its input cannot be used.

    Args:
        out: what was given as --out.
    """
    try:
        return work()
    except (OSError, ValueError) as error:
        complain(command, _of_out(error, out) or error)
        return 1


def _of_out(error: Exception, out: Path | None) -> str:
    """What is wrong with --out; "" where the error is another."""
    if out is None or not isinstance(error, OSError) or not lies_at(error, out):
        return ""
    return f"--out {out}: cannot be written ({error.strerror}: {error.filename}); give another place as --out"


def lies_at(error: OSError, place: Path) -> bool:
    """Whether what could not be read or written lies at `place`, or is needed to make that folder."""
    if not isinstance(error.filename, str):
        return False
    path, folder = Path(error.filename).absolute(), place.absolute()
    return path.is_relative_to(folder) or (folder.is_relative_to(path) and not folder.is_dir())


def complain(command: str, *errors: Exception | str, see: str = FAILED) -> None:
    """Say on standard error what is wrong, and once each the pages that help.

    Args:
        see: the page that helps where an error is words.
    """
    for error in errors:
        print(f"envgs-bench {command}: {plain(str(error))}", file=sys.stderr)
    lines = (help_at(see) if isinstance(error, str) else help_on(type(error).__name__) for error in errors)
    for line in dict.fromkeys(lines):
        print(line, file=sys.stderr)
