"""`envgs-bench masks`: masks of what reflects, from an EnvGS that was trained on a capture."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from .explained import explained


def main(arguments: Sequence[str]) -> int:
    """Write the masks; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench masks",
        description="Masks of what reflects, for every view of a capture, from an EnvGS that was trained on it.",
        allow_abbrev=False,
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="the folder of one run of method=envgs")
    parser.add_argument(
        "--region",
        required=True,
        choices=["reflective", "near_field"],
        help="reflective: what reflects, made as in the EnvGS paper; near_field: what reflects near things, our own",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", required=True, help="masks_<region>/ goes here; the capture's folder uses it"
    )
    parser.add_argument(
        "--beta", type=float, default=0.2, metavar="B", help="a primitive reflects where its β is above (default 0.2)"
    )
    parser.add_argument(
        "--foreground",
        type=float,
        nargs=4,
        metavar=("X", "Y", "Z", "RADIUS"),
        help="the ball that holds the foreground, in the data's coordinates; by default what the cameras stand around",
    )
    parser.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"])
    options = parser.parse_args(arguments)
    return explained("masks", lambda: _masks(options))


def _masks(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import Progress

    from envgs_bench.stored.region_masks import MaskChoice, make_masks

    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(f"masks {options.region}", total=None)
        for done, total in make_masks(
            options.run, MaskChoice(options.region, options.beta, options.foreground), options.out, options.device
        ):
            progress.update(task, completed=done, total=total)
    folder = options.out / f"masks_{options.region}"
    print(f"{total} masks: {folder}, made as {folder}.json says")
    return 0
