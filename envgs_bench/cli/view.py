"""`envgs-bench view`: trained runs in the browser."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from .explained import explained


def main(arguments: Sequence[str]) -> int:
    """Serve the page until Ctrl-C or SIGTERM; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench view",
        description="Trained runs in the browser: walk around, look at layers, compare two runs of one scene, or a run "
        "with another program's Gaussians.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "runs",
        type=Path,
        nargs="+",
        metavar="RUN",
        help="a run's folder, with its checkpoint; or, beside one, a .ply, .spz or .sog in the coordinates of its data",
    )
    parser.add_argument("--port", type=int, default=8080, metavar="N", help="default 8080, or the next that is free")
    parser.add_argument("--host", default="127.0.0.1", help="who may look: 0.0.0.0 for everybody in the network")
    parser.add_argument("--rows", type=int, default=720, metavar="N", help="most rows of a picture (default 720)")
    parser.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"])
    options = parser.parse_args(arguments)
    return explained("view", lambda: _view(options))


def _view(options: argparse.Namespace) -> int:
    from envgs_bench.viewing.opened import open_runs
    from envgs_bench.viewing.viewer import Viewer, require_viser

    require_viser()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # services are stopped so
    server = None
    try:
        runs = open_runs(options.runs, options.device)
        for text in dict.fromkeys(text for run in runs for text in run.method.notes):
            print(text, file=sys.stderr)
        server = Viewer(runs, options.rows).serve(options.host, options.port)
        print(f"open http://{options.host}:{server.get_port()} in a browser; Ctrl-C ends this", flush=True)
        server.sleep_forever()
    except KeyboardInterrupt:
        if server is not None:
            server.stop()
    return 0
