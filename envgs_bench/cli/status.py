"""`envgs-bench status RUNS`: what runs where, how far it has come, and what failed."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from .explained import complain


def main(arguments: Sequence[str]) -> int:
    """Print the state of the runs in the folder that `arguments` name; the exit status."""
    parser = argparse.ArgumentParser(
        prog="envgs-bench status",
        description="What runs where, how far it has come, and what failed. Reads only, at any time, from anywhere.",
        allow_abbrev=False,
    )
    parser.add_argument("runs", type=Path, help="the runs_dir of an `envgs-bench run`, or a part of it")
    options = parser.parse_args(arguments)
    from envgs_bench.records import RecordError
    from envgs_bench.runs.overview import overview

    try:
        states = overview(options.runs)
    except RecordError as error:
        complain("status", error)
        return 1
    _print(states, options.runs)
    return 0


def _print(states: Sequence, root: Path) -> None:
    from envgs_bench.pages import help_on
    from envgs_bench.plain_text import plain, plain_line

    counts = Counter(state.state for state in states)
    print(
        f"{len(states)} runs: " + (", ".join(f"{count} {name}" for name, count in counts.most_common()) or "none yet")
    )
    for state in states:
        name = state.folder.relative_to(root) if state.folder != root else state.folder.name
        if state.holder is not None:
            silent = f", silent for {state.silent_seconds:.0f} s" if state.silent_seconds > 60 else ""
            print(plain(f"{name}: {state.progress}{silent}  ({state.holder}, {state.state})"))
        elif state.message:
            print(plain(f"{name}: {state.state}: {plain_line(state.message)[:300]}"))
    if any(state.message for state in states):
        print(help_on(""))
