"""`envgs-bench report`: tables, charts and a page, from records alone."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from .explained import explained


def main(arguments: Sequence[str]) -> int:
    """Write the report; the exit status is 1 where nothing was written or a record is missing from it."""
    parser = argparse.ArgumentParser(prog="envgs-bench report", description="Tables, charts and a page from records.")
    parser.add_argument("runs", type=Path, metavar="RUNS", help="a folder with runs: the runs_dir of `run`")
    parser.add_argument("--out", type=Path, metavar="DIR", help="where to write; RUNS/report by default")
    for option, help_text in (("--only", "runs that match this alone"), ("--exclude", "runs that match this not")):
        parser.add_argument(
            option,
            action="append",
            default=[],
            metavar="PATTERN",
            help=f"{help_text}: a method, a data set, a status or a path below RUNS, with * and ?; may be given again",
        )
    options = parser.parse_args(arguments)
    return explained("report", lambda: _report(options))


def _report(options: argparse.Namespace) -> int:
    from envgs_bench.reports import build_report

    report = build_report(options.runs, options.out or options.runs / "report", options.only, options.exclude)
    print(report)
    for record in report.broken:
        print(f"envgs-bench report: {record.path}: {record.reason}", file=sys.stderr)
    return int(bool(report.broken))
