"""`envgs-bench rescore`: finished runs under another protocol, without training them again."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from .explained import complain, explained


def main(arguments: Sequence[str]) -> int:
    """Score every run again; the exit status is 1 where there is none, or one cannot be scored."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench rescore",
        description="Finished runs under another protocol, without training them again.",
        allow_abbrev=False,
    )
    parser.add_argument("runs", type=Path, metavar="RUNS", help="a folder with runs, or one run's")
    parser.add_argument("--protocol", required=True, metavar="NAME", help="`envgs-bench list` names them")
    parser.add_argument("--out", type=Path, metavar="DIR", help="where records go; RUNS-<protocol> by default")
    parser.add_argument(
        "--redraw",
        action="store_true",
        help="draw the views again from the checkpoints, instead of taking the 8-bit pictures that runs left: "
        "for protocols that score floats, and for masks added since; needs the data",
    )
    parser.add_argument(
        "--device", default="auto", choices=["auto", "cpu", "cuda"], help="where LPIPS is computed, and --redraw draws"
    )
    options = parser.parse_args(arguments)
    return explained("rescore", lambda: _rescore(options), options.out)


def _rescore(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import track

    from envgs_bench.metrics import get_protocol
    from envgs_bench.records import RecordError, find_records
    from envgs_bench.stored.rescoring import redraw, rescore

    runs, protocol = options.runs, get_protocol(options.protocol)
    out = options.out or Path(f"{runs.resolve()}-{options.protocol}")
    if runs.resolve().is_relative_to(out.resolve()):
        raise ValueError(f"--out {out}: is or holds {runs}, whose records it must not touch; give another folder")
    folders = [path.parent for path in find_records(runs) if out.resolve() not in path.resolve().parents]
    if not folders:
        raise RecordError(
            f"{runs}: no record.json under it: give the runs_dir of an `envgs-bench run`, or one run's folder"
        )
    names, problems = set(), []
    for folder in track(folders, "scoring", console=Console(stderr=True), transient=True):
        below = folder.relative_to(runs)
        target = out / (folder.resolve().name if below == Path() else below)
        try:
            again = (
                redraw(folder, protocol, target, options.device)
                if options.redraw
                else rescore(folder, protocol, target, options.device)
            )
            names.add(again.protocol.name)
        except (OSError, ValueError) as error:
            problems.append(error)
    print(f"{len(folders) - len(problems)} records under protocol {', '.join(sorted(names)) or protocol.name}: {out}")
    complain("rescore", *problems)
    return int(bool(problems))
