"""`envgs-bench report`: tables, charts and a page, from records alone."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from .explained import complain, explained


def main(arguments: Sequence[str]) -> int:
    """Write the report; the exit status is 1 where nothing was written, a record is missing from it or scores fell."""
    parser = argparse.ArgumentParser(prog="envgs-bench report", description="Tables, charts and a page from records.")
    parser.add_argument("runs", type=Path, metavar="RUNS", help="a folder with runs: the runs_dir of `run`")
    parser.add_argument("--out", type=Path, metavar="DIR", help="where to write; RUNS/report by default")
    for option, help_text in (("--only", "runs that match this alone"), ("--exclude", "runs that match this not")):
        parser.add_argument(
            option,
            action="append",
            default=[],
            metavar="PATTERN",
            help=f"{help_text}: a method, a data set, a status, steps=COUNT or a path below RUNS, with * and ?; "
            "may be given again",
        )
    parser.add_argument(
        "--print",
        action="store_true",
        dest="for_print",
        help="also what a paper takes: LaTeX tables, a PDF beside every chart, and charts of every pair of columns",
    )
    parser.add_argument(
        "--keep",
        type=Path,
        metavar="FILE.csv",
        help="write no report: add a row for each run to this file, in place of an earlier row of the same run",
    )
    parser.add_argument(
        "--keep-perturbed",
        type=Path,
        metavar="FILE.csv",
        help="write no report: add a short row for each run of a stability study to this file, partners and all",
    )
    parser.add_argument(
        "--commit", default="", metavar="HASH", help="with --keep and --keep-perturbed: of runs that do not know theirs"
    )
    parser.add_argument(
        "--fill",
        type=Path,
        metavar="PAGE.md",
        help="write no report: make the tables of this page anew from the kept runs, CSV files in the folder RUNS",
    )
    parser.add_argument(
        "--figure",
        type=Path,
        metavar="FILE.webp",
        help="write no report: one picture of two test views of a data set, as every method drew them, with a crop "
        "of each at the pixels' own size; .jpg too",
    )
    parser.add_argument(
        "--against",
        type=Path,
        metavar="OLD",
        help="first list what left the band of its seeds since OLD, a folder of runs or a CSV that --keep wrote; the "
        "exit status is 1 where a score got worse or runs fail that did not",
    )
    options = parser.parse_args(arguments)
    if options.fill:
        return explained("report", lambda: _fill(options.fill, options.runs))
    if options.figure:
        return explained("report", lambda: _figure(options))
    if options.keep or options.keep_perturbed:
        return explained("report", lambda: _keep(options))
    return explained("report", lambda: _report(options), options.out)


def _fill(page: Path, folder: Path) -> int:
    from envgs_bench.records import write_atomically
    from envgs_bench.reports.documentation import fill_page

    text, absent = fill_page(page, folder)
    write_atomically(page, text)
    print(page)
    complain("report", *(f"{page}: not measured: {asked}" for asked in absent), see="how_to/add_table")
    return 0


def _figure(options: argparse.Namespace) -> int:
    from envgs_bench.reports.pictures.figure import draw_figure

    gallery = draw_figure(options.runs, options.figure, options.only, options.exclude)
    print(f"{gallery.dataset}, {', '.join(gallery.methods)}: {options.figure}")
    return 0


def _keep(options: argparse.Namespace) -> int:
    from envgs_bench.reports.kept.perturbed_file import keep_perturbed
    from envgs_bench.reports.kept.runs_file import keep_runs
    from envgs_bench.reports.numbers.runs import read_runs

    found, broken = read_runs(options.runs, options.only, options.exclude)
    for keep, path in ((keep_runs, options.keep), (keep_perturbed, options.keep_perturbed)):
        if path:
            print(f"{len(found)} runs, {keep(found, path, options.commit)} in {path}")
    complain("report", *(f"{record.path}: {record.reason}" for record in broken), see="reference/records")
    return int(bool(broken) or not found)


def _report(options: argparse.Namespace) -> int:
    from envgs_bench.reports import build_report
    from envgs_bench.reports.outputs import require_no_others_page

    out = options.out or options.runs / "report"
    require_no_others_page(out)
    worse = _compare(options, out) if options.against else False
    report = build_report(options.runs, out, options.only, options.exclude, options.for_print)
    print(report)
    complain("report", *(f"{record.path}: {record.reason}" for record in report.broken), see="reference/records")
    return int(bool(report.broken) or worse)


def _compare(options: argparse.Namespace, out: Path) -> bool:
    """Print and write what changed since the earlier runs; whether something got worse."""
    from rich.console import Console
    from rich.table import Table

    from envgs_bench.plain_text import plain
    from envgs_bench.records import write_atomically
    from envgs_bench.reports.kept.against import against, as_markdown, as_table
    from envgs_bench.reports.numbers.runs import read_runs

    found = against(read_runs(options.runs, options.only, options.exclude)[0], options.against)
    out.mkdir(parents=True, exist_ok=True)
    write_atomically(out / "against.md", as_markdown(found, options.against))
    heads, *rows = as_table(found)
    table = Table(*heads, box=None, pad_edge=False)
    for row in rows:
        table.add_row(*map(plain, row))
    Console(width=None if sys.stdout.isatty() else 160).print(table, highlight=False, markup=False)
    print(f"{len(rows)} of {found.compared} cells left the band of their seeds since {options.against}")
    return found.got_worse
