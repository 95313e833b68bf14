"""`envgs-bench bench core`: how long the core takes, and how that grows. Parses before it imports anything slow."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from .arguments import positive, size

DESCRIPTION = """\
Time rasterize, trace and build on a room of Gaussians: medians, and the distance between the quartiles.

Without options: the traced and rasterized cases that targets are stated for, and the native backends beside the torch
oracle on a picture small enough for it. With --primitives or --size: every operation at each of them.
forward draws without gradients; forward_backward differentiates every output in every field and, for trace, in the
rays. The BVH is built outside of trace's time: that is the row `build`. On a GPU also an EnvGS image (envgs, forward)
and a training step (forward_backward), with five base surfels for each of the environment's.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark and print its table; the exit status."""
    options = _parser().parse_args(arguments)
    from rich.console import Console
    from rich.progress import track

    from envgs_bench.core import available_backends

    from .cases import chosen_cases, peer_cases, sweep_cases, time_case
    from .peers import why_unavailable
    from .table import ratios, table

    reasons = available_backends()
    backends = options.backend or [name for name in ("cpu", "cuda", "torch") if reasons[name] is None]
    for name in backends:
        if reasons[name] is not None:
            print(f"envgs-bench bench core: backend {name!r} does not work here: {reasons[name]}", file=sys.stderr)
            return 1
    cases = chosen_cases(backends, options.primitives, options.size)
    if options.peers:
        reason = why_unavailable()
        if reason or "cuda" not in backends:
            print(f"envgs-bench bench core --peers: {reason or 'needs the cuda backend'}", file=sys.stderr)
            return 1
        cases += peer_cases(cases)
    if options.chart is not None and not (options.primitives or options.size):
        cases = list(dict.fromkeys([*cases, *sweep_cases([name for name in backends if name in ("cpu", "cuda")])]))

    rows: list[dict] = []
    try:
        for case in track(cases, description="timing", console=Console(stderr=True)):
            rows.append(time_case(case, options.repeats))
    finally:  # an interrupted benchmark keeps what it has
        if options.json is not None:
            options.json.parent.mkdir(parents=True, exist_ok=True)
            options.json.write_text(json.dumps(rows, indent=1) + "\n")
    console = Console(width=None if sys.stdout.isatty() else 160)
    console.print(table(rows))
    for line in ratios(rows):
        console.print(line, highlight=False)
    if options.chart is not None:
        from .chart import draw_chart

        draw_chart(rows, options.chart)
        console.print(f"chart: {options.chart}", highlight=False)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="envgs-bench bench core", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--primitives", type=positive, nargs="+", metavar="N", help="numbers of Gaussians")
    parser.add_argument("--size", type=size, nargs="+", metavar="WxH", help="sizes of the picture: 160x120 640x480")
    parser.add_argument(
        "--backend",
        nargs="+",
        choices=("cpu", "cuda", "torch", "embree"),
        help="default: the native ones that work here, and torch",
    )
    parser.add_argument("--repeats", type=positive, default=20, metavar="N", help="timed calls a case (default: 20)")
    parser.add_argument("--peers", action="store_true", help="also time gsplat's rasterizers, where it is installed")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows here")
    parser.add_argument("--chart", type=Path, metavar="FILE", help="sweep primitives and sizes, and draw them (png)")
    return parser
