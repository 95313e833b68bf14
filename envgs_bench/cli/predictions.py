"""`envgs-bench predictions`: a run's pictures and scores in nerfbaselines' format."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from .explained import explained


def main(arguments: Sequence[str]) -> int:
    """Write both files; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench predictions",
        description="A run's test views and scores as nerfbaselines has them: predictions.tar.gz and results.json.",
        allow_abbrev=False,
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="one finished run's folder")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="where both files go")
    options = parser.parse_args(arguments)
    return explained("predictions", lambda: _predictions(options), options.out)


def _predictions(options: argparse.Namespace) -> int:
    from envgs_bench.stored.nerfbaselines import write_predictions

    for path in write_predictions(options.run, options.out):
        print(path)
    return 0
