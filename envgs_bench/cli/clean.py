"""`envgs-bench clean RUNS`: remove runs that did not finish."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from .explained import explained

STATUSES = ("failed", "diverged", "out_of_memory", "timeout", "interrupted", "killed", "unreadable")


def main(arguments: Sequence[str]) -> int:
    """List the runs, and remove them where that is asked for; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench clean",
        description="Runs that did not finish, and with --yes, remove them. What somebody is running is left alone.",
        allow_abbrev=False,
    )
    parser.add_argument("runs", type=Path, metavar="RUNS", help="a folder with runs: the runs_dir of `run`")
    parser.add_argument(
        "--status",
        action="append",
        choices=STATUSES,
        help="only those that ended so; may be given again, failed and unreadable by default",
    )
    parser.add_argument("--yes", action="store_true", help="remove them")
    options = parser.parse_args(arguments)
    statuses = options.status or ["failed", "unreadable"]
    return explained("clean", lambda: _clean(options.runs, statuses, options.yes))


def _clean(runs: Path, statuses: Sequence[str], remove: bool) -> int:
    from envgs_bench.plain_text import plain, plain_line
    from envgs_bench.run_folder import clear
    from envgs_bench.run_lock import locked
    from envgs_bench.runs.overview import overview

    found = [state for state in overview(runs) if state.state in statuses]
    for state in found:
        print(plain(f"{state.folder}: {state.state}: {plain_line(state.message)[:200]}"))
        if remove:
            with locked(state.folder) as run_lock:
                if run_lock is not None:
                    clear(state.folder)
            _remove_empty(state.folder, runs)
    what = "removed" if remove else "would be removed: add --yes"
    print(f"{len(found)} runs {what}" if found else f"no run is {' or '.join(statuses)}")
    return 0


def _remove_empty(folder: Path, top: Path) -> None:
    """Remove the folder, and those above it up to `top`, where nothing of anybody's is left in them."""
    while folder != top and not any(folder.iterdir()):
        folder.rmdir()
        folder = folder.parent
