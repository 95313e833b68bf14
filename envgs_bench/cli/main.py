"""The `envgs-bench` command: names its commands and hands over to the file of the one that is called."""

from __future__ import annotations

import argparse
import atexit
import gc
import importlib
import os
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version

from envgs_bench.stages.stop import INTERRUPTED

# Each is a file of this folder with a `main(arguments) -> exit status`, imported only when it is called; there `--help`
# prints before anything slow is imported.
COMMANDS = {
    "run": "train, render, score and time; `run --help` lists the keys",
    "status": "what runs where, how far it has come, and what failed",
    "report": "tables, charts and pages from records",
    "rescore": "finished runs under another protocol, without training them again",
    "masks": "masks of what reflects, from an EnvGS that was trained on a capture",
    "view": "trained runs in the browser: walk around, look at layers, compare two",
    "render": "a film of a trained run along a camera path, its layers side by side",
    "clean": "remove runs that did not finish",
    "store": "the model that a run trained, as PLY, as one small file, or in a viewer's layout",
    "predictions": "a run's pictures and scores in nerfbaselines' format",
    "layouts": "what each layout of trained models takes on disk, and what pictures lose by it",
    "download": "a published data set, fetched and unpacked where its configuration expects it",
    "export": "a data set in COLMAP's or blender's layout",
    "list": "methods, data sets, protocols, experiments, backends; what each method is, the settings of one",
    "diagnose": "how often warnings and repairs are wrong, counted on sampled scenes",
    "bench": "how long the core takes, and what a training is worth at any time",
    "completion": "what bash and zsh complete commands and names by",
    "weights": "fetch VGG-16's weights, which LPIPS and the perceptual loss need",
    "doctor": "what works on this machine, and why not what does not",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that `arguments` (sys.argv's by default) begin with; returns its exit status."""
    # OpenMP reads this as PyTorch is loaded, here and in the runs started from here. Threads that wait by spinning cost
    # a run beside another (a parallel sweep, a shared machine) ten times its own time.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    atexit.register(gc.freeze)  # else all that libraries made is looked through once more at the end: 0.3 s
    given = list(sys.argv[1:] if arguments is None else arguments)
    parser = _parser()
    if not given:  # whoever is new here sees what there is
        parser.print_help(sys.stderr)
        parser.exit(2)
    command = parser.parse_args(given[:1]).command
    try:
        return importlib.import_module(f".{command}", __package__).main(given[1:])
    except KeyboardInterrupt:  # while it imports, or where nothing is to be saved
        print(f"envgs-bench {command}: interrupted", file=sys.stderr)
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="envgs-bench",
        description="Benchmark novel-view synthesis of reflective scenes: speed, accuracy, stability, size.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {_version()}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, purpose in COMMANDS.items():
        commands.add_parser(name, help=purpose, add_help=False)
    return parser


def _version() -> str:
    try:
        return version("envgs-bench")
    except PackageNotFoundError:
        return "unknown: not installed"


if __name__ == "__main__":
    sys.exit(main())
