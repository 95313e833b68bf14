"""`envgs-bench doctor`: what works on this machine, and why not what does not."""

from __future__ import annotations

import argparse
from collections.abc import Sequence


def main(arguments: Sequence[str]) -> int:
    """Print what works; the exit status is 1 where nothing can be drawn."""
    parser = argparse.ArgumentParser(prog="envgs-bench doctor", description="What works on this machine.")
    parser.parse_args(arguments)
    from .examination import examine

    return examine()
