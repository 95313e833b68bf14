"""How a command ends whose input cannot be used."""

from __future__ import annotations

import sys
from collections.abc import Callable

from envgs_bench.pages import help_on


def explained(command: str, work: Callable[[], int]) -> int:
    """The exit status of `work`; 1 with the explanation on standard error where its input cannot be used."""
    try:
        return work()
    except (OSError, ValueError) as error:
        print(f"envgs-bench {command}: {error}\n{help_on(type(error).__name__)}", file=sys.stderr)
        return 1
