"""`envgs-bench layouts`: what each layout of trained models takes on disk, and what pictures lose by it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from .explained import complain, explained


def main(arguments: Sequence[str]) -> int:
    """Write and print the table; the exit status is 1 where there is no run, or one cannot be stored or scored."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench layouts",
        description="What each layout of trained models takes on disk, and what pictures lose by it.",
        allow_abbrev=False,
    )
    parser.add_argument("runs", type=Path, metavar="RUNS", help="a folder with finished runs, or one run's")
    parser.add_argument(
        "--layout",
        action="append",
        dest="layouts",
        metavar="NAME",
        help="one of those that `envgs-bench list` names; may be given again; by default all that can be written here",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", required=True, help="layouts.csv and layouts.md go here")
    parser.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"])
    options = parser.parse_args(arguments)
    return explained("layouts", lambda: _layouts(options), options.out)


def _layouts(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import track

    from envgs_bench.records import find_records
    from envgs_bench.stored.layout_losses import as_csv, as_markdown, layout_losses, layouts_here, require_layouts

    layouts, others = (require_layouts(options.layouts), "") if options.layouts else layouts_here()
    options.out.mkdir(parents=True, exist_ok=True)  # before minutes of work
    if others:
        print(f"envgs-bench layouts: left out: {others}", file=sys.stderr)
    folders = [path.parent for path in find_records(options.runs)]
    losses, problems = [], []
    for folder in track(folders, "storing", console=Console(stderr=True), transient=True):
        try:
            for loss in layout_losses(folder, layouts, options.device):
                losses.append(loss)
        except (OSError, ValueError) as error:
            problems.append(error)
    (options.out / "layouts.csv").write_text(as_csv(losses), encoding="utf-8")
    (options.out / "layouts.md").write_text(as_markdown(losses), encoding="utf-8")
    print(as_markdown(losses), end="")
    complain("layouts", *problems)
    return int(bool(problems) or not folders)
