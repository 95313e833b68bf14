"""How a command ends whose input cannot be used."""

from __future__ import annotations

import sys
from collections.abc import Callable

from envgs_bench.pages import FAILED, help_at, help_on
from envgs_bench.plain_text import plain


def explained(command: str, work: Callable[[], int]) -> int:
    """The exit status of `work`; 1 with the explanation on standard error where its input cannot be used."""
    try:
        return work()
    except (OSError, ValueError) as error:
        complain(command, error)
        return 1


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
