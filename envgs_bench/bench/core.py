"""`envgs-bench bench core`: how long the core takes, and how that grows. Parses before it imports anything slow."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .arguments import positive, size
from .cases import OPERATIONS, PEERS, Case, chosen_cases, peer_cases, sweep_cases

if TYPE_CHECKING:
    from .run_workload import TimedRun

DESCRIPTION = """\
Time the core and what a training step does around it: medians, and the distance between the quartiles.

Without options, on a room of Gaussians: the traced and rasterized cases that targets are stated for, what else a
training step takes (building the BVH, Adam, SSIM, a map's lookup), on a GPU also an image and a training
step of each method, and the native backends beside the torch oracle on a picture small enough for it. With --primitives
or --size: rasterize, trace and build at each of them, or what --op names. With --scene: all of it on what a trained run
has learned, where its cameras stand.
forward draws without gradients; forward_backward differentiates every output in every field and, for trace, in the
rays; of a method they are an image and a training step. The BVH is built outside of trace's time: that is the row
`build`. envgs has five base surfels for each of the environment's, which the room's rows count.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark and print its table; the exit status."""
    options = _parser().parse_args(arguments)
    from rich.console import Console
    from rich.progress import track

    from .interruptible import interruptible
    from .rows import time_case
    from .table import ratios, table

    try:
        cases, run = _chosen(options)
    except (ValueError, OSError) as error:
        print(f"envgs-bench bench core: {error}", file=sys.stderr)
        return 1
    rows: list[dict] = []
    console = Console(width=None if sys.stdout.isatty() else 200)
    try:
        with interruptible() as ending:
            for case in track(cases, description="timing", console=Console(stderr=True)):
                rows.append(time_case(case, options.repeats, run))
                if options.json is not None:
                    _write(rows, options.json)
    finally:
        if rows:
            console.print(table(rows))
    if ending.status:
        print(f"envgs-bench bench core: interrupted after {len(rows)} of {len(cases)} cases", file=sys.stderr)
        return ending.status
    for line in ratios(rows):
        console.print(line, highlight=False)
    if options.chart is not None:
        from .chart import draw_chart

        draw_chart(rows, options.chart)
        console.print(f"chart: {options.chart}", highlight=False)
    return 0


def _write(rows: Sequence[dict], path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(rows, indent=1) + "\n")


def _chosen(options: argparse.Namespace) -> tuple[list[Case], TimedRun | None]:
    """What is timed, and the run that it is timed on. Raises ValueError where something of that cannot be had."""
    backends = _backends(options)
    run = None
    if options.scene is None:
        cases = chosen_cases(backends, options.primitives, options.size, options.op)
    elif options.primitives or options.size or options.chart:
        raise ValueError(
            "a run has its own primitives and sizes: give --scene without --primitives, --size and --chart"
        )
    else:
        from .run_workload import TimedRun

        run = TimedRun.opened(options.scene, options.views)
        cases = run.cases(backends, options.op)
    known = list(run.counts if run else OPERATIONS)
    unknown = [op for op in options.op or () if op not in known]
    if unknown or not cases:
        wanted = " ".join(["--op", *(unknown or options.op or ())])
        raise ValueError(f"{wanted}: expected some of {', '.join(known)}, and a backend that has them")
    if options.peers:
        cases += peer_cases(cases, _peers(cases))
    if options.chart is not None and not (options.primitives or options.size):
        cases = list(dict.fromkeys([*cases, *sweep_cases([name for name in backends if name in ("cpu", "cuda")])]))
    return cases, run


def _backends(options: argparse.Namespace) -> list[str]:
    """Those that were asked for, or else work here."""
    from envgs_bench.core import available_backends

    reasons = available_backends()
    for name in options.backend or ():
        if reasons[name] is not None:
            raise ValueError(f"backend {name!r} does not work here: {reasons[name]}")
    works = [name for name in ("cpu", "cuda", "torch") if reasons[name] is None]
    if options.scene is not None:
        works = ["cuda"] if "cuda" in works else ["cpu"]
    return options.backend or works


def _peers(cases: Sequence[Case]) -> list[str]:
    """Those that are installed and have any of the cases; why others of these are left out goes to stderr.

    Raises ValueError where there is none.
    """
    from .peers import why_unavailable

    reasons = {peer: why_unavailable(peer) for peer in PEERS if peer_cases(cases, [peer])}
    if not reasons:
        drawn = ", ".join(dict.fromkeys(op for operations in PEERS.values() for op in operations))
        raise ValueError(f"--peers: needs the cuda backend, and some of {drawn}, which is what they have")
    found = [peer for peer, reason in reasons.items() if reason is None]
    if not found:
        raise ValueError(f"--peers: {'; '.join(filter(None, reasons.values()))}")
    for reason in filter(None, reasons.values()):
        print(f"envgs-bench bench core: left out, {reason}", file=sys.stderr)
    return found


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="envgs-bench bench core", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--primitives", type=positive, nargs="+", metavar="N", help="numbers of Gaussians")
    parser.add_argument("--size", type=size, nargs="+", metavar="WxH", help="sizes of the picture: 160x120 640x480")
    parser.add_argument("--scene", type=Path, metavar="RUN", help="time what the run in this folder has learned")
    parser.add_argument(
        "--views", type=positive, default=4, metavar="N", help="of a run: so many of its views, spread (default: 4)"
    )
    parser.add_argument("--op", nargs="+", metavar="OP", help=f"only these: {', '.join(OPERATIONS)}")
    parser.add_argument(
        "--backend",
        nargs="+",
        choices=("cpu", "cuda", "torch", "embree"),
        help="default: the native ones that work here, and torch; of a run the fastest of the native ones",
    )
    parser.add_argument("--repeats", type=positive, default=20, metavar="N", help="timed calls a case (default: 20)")
    parser.add_argument("--peers", action="store_true", help="also time gsplat's rasterizers and HiGS, where installed")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows here")
    parser.add_argument("--chart", type=Path, metavar="FILE", help="sweep primitives and sizes, and draw them (png)")
    return parser
