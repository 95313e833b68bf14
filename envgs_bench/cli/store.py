"""`envgs-bench store`: the model that a run trained, as files in the layout that is asked for."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from .explained import explained


def main(arguments: Sequence[str]) -> int:
    """Write the files and name them; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench store",
        description="The model that a run trained, as files for viewers and other programs, or as one small file.",
        allow_abbrev=False,
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="one run's folder, with its checkpoint")
    parser.add_argument("--layout", required=True, metavar="NAME", help="`envgs-bench list` names them")
    parser.add_argument("--out", type=Path, metavar="DIR", required=True, help="where the files are written")
    options = parser.parse_args(arguments)
    return explained("store", lambda: _store(options.run, options.layout, options.out))


def _store(run: Path, name: str, out: Path) -> int:
    from envgs_bench.stored.layout_losses import open_sets, require_layouts

    (layout,) = require_layouts([name]).values()
    _, method = open_sets(run, "cpu")
    for path in layout.write(method, out):
        print(path)
    if lacking := layout.lacks(method):
        print(f"envgs-bench store: {name} has no place for {', '.join(lacking)}: left out", file=sys.stderr)
    return 0
