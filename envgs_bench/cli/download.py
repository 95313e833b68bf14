"""`envgs-bench download`: a published data set, made ready where its configuration expects it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from .explained import explained


def main(arguments: Sequence[str]) -> int:
    """Fetch and unpack; the exit status is 1 where the data cannot be had, and the message says what to do by hand."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench download",
        usage="envgs-bench download NAME [KEY=VALUE ...] [--photographs DIR] [--sha256 HEX]",
        description="Fetch a published data set, as ref_real/sedan, and unpack it below data_root=… (default: data/). "
        "captures/… are made of published photographs: undistorted, made smaller, and given points.",
        allow_abbrev=False,
    )
    parser.add_argument("name", help="a dataset that `envgs-bench list` names")
    parser.add_argument(
        "--photographs", type=Path, metavar="DIR", help="the published ones, where they are here already"
    )
    parser.add_argument("--sha256", metavar="HEX", help="what the archive's SHA-256 must be")
    options, overrides = parser.parse_known_args(arguments)
    return explained("download", lambda: _download(options.name, overrides, options.photographs, options.sha256))


def _download(name: str, overrides: list[str], photographs: Path | None, sha256: str | None) -> int:
    from .dataset_download import download

    return download(name, overrides, photographs, sha256)
