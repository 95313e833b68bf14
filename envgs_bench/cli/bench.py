"""`envgs-bench bench`: time the core itself."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Sequence

SUBJECTS = {"core": "rasterizing, tracing and building", "tracers": "reflected rays by our tracer and by slower ways"}


def main(arguments: Sequence[str]) -> int:
    """Time the subject that `arguments` begin with; the exit status."""
    parser = argparse.ArgumentParser(prog="envgs-bench bench", description="Time the core itself.")
    subjects = parser.add_subparsers(dest="subject", required=True, metavar="SUBJECT")
    for name, purpose in SUBJECTS.items():
        subjects.add_parser(name, help=purpose, add_help=False)
    subject = parser.parse_args(arguments[:1]).subject
    return importlib.import_module(f"envgs_bench.bench.{subject}").main(arguments[1:])
