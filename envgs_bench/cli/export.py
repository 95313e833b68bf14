"""`envgs-bench export`: a data set in COLMAP's or blender's layout."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from .explained import explained


def main(arguments: Sequence[str]) -> int:
    """Write the data set; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench export",
        usage="envgs-bench export [KEY=VALUE ...] --format FORMAT --out DIR",
        description="Write a data set, given as for `run`: dataset=toy/glass dataset.width=320",
        allow_abbrev=False,
    )
    parser.add_argument("--format", choices=["colmap", "colmap-text", "blender"], default="colmap")
    parser.add_argument("--out", type=Path, metavar="DIR", required=True, help="a new folder")
    options, overrides = parser.parse_known_args(arguments)
    return explained("export", lambda: _export(overrides, options.format, options.out), options.out)


def _export(overrides: list[str], form: str, out: Path) -> int:
    from .scene_export import export

    return export(overrides, form, out)
