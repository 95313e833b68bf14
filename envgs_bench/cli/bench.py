"""`envgs-bench bench`: how long the core takes, and what a training is worth at any time."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Sequence

SUBJECTS = {  # subject: its module, and what it is
    "core": ("envgs_bench.bench.core", "the core, in a room or on a trained run"),
    "tracers": ("envgs_bench.bench.tracers", "reflected rays by our tracer and by slower ways"),
    "train": ("envgs_bench.cli.bench_train", "PSNR against seconds of training, beside gsplat's"),
}


def main(arguments: Sequence[str]) -> int:
    """Time the subject that `arguments` begin with; the exit status."""
    parser = argparse.ArgumentParser(prog="envgs-bench bench", description="Time the core, or trainings.")
    subjects = parser.add_subparsers(dest="subject", required=True, metavar="SUBJECT")
    for name, (_, purpose) in SUBJECTS.items():
        subjects.add_parser(name, help=purpose, add_help=False)
    subject = parser.parse_args(arguments[:1]).subject
    return importlib.import_module(SUBJECTS[subject][0]).main(arguments[1:])
