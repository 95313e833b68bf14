"""`envgs-bench masks`: masks of what reflects in a capture, by a run on it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from .explained import explained


def main(arguments: Sequence[str]) -> int:
    """Write the masks; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench masks",
        description="Masks of what reflects, for every view of a capture, by a run on it.",
        allow_abbrev=False,
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="the folder of one run; by beta of method=envgs")
    parser.add_argument(
        "--region",
        required=True,
        choices=["reflective", "near_field"],
        help="reflective: what reflects, made as in the EnvGS paper; near_field: what reflects near things, our own",
    )
    parser.add_argument(
        "--by",
        default="beta",
        choices=["beta", "photographs"],
        help="beta: what an EnvGS found to reflect (default); photographs: what looks different from other sides, on "
        "the surfaces of any run",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", required=True, help="masks_<region>/ goes here; the capture's folder uses it"
    )
    parser.add_argument(
        "--beta", type=float, metavar="B", help="by beta: a primitive reflects where its β is above (default 0.2)"
    )
    parser.add_argument(
        "--foreground",
        type=float,
        nargs=4,
        metavar=("X", "Y", "Z", "RADIUS"),
        help="by beta: the ball that holds the foreground, in the data's coordinates; by default what the cameras "
        "stand around",
    )
    parser.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"])
    options = parser.parse_args(arguments)
    return explained("masks", lambda: _masks(options), options.out)


def _masks(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import Progress

    from envgs_bench.stored.region_masks import MaskChoice, make_masks

    if options.by == "photographs":
        ignored = {"--region near_field": options.region == "near_field", "--beta": options.beta is not None}
        ignored["--foreground"] = options.foreground is not None
        if wrong := [name for name, given in ignored.items() if given]:
            raise ValueError(f"{', '.join(wrong)}: photographs say nothing of that; leave it out, or take --by beta")
    beta = 0.2 if options.beta is None else options.beta
    choice = MaskChoice(options.region, options.by, beta, options.foreground)
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(f"masks {options.region}", total=None)
        for done, total in make_masks(options.run, choice, options.out, options.device):
            progress.update(task, completed=done, total=total)
    folder = options.out / f"masks_{options.region}"
    print(f"{total} masks: {folder}, made as {folder}.json says")
    return 0
