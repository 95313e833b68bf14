"""Which files a report is made of, so that the next one in the same folder leaves none of them behind."""

from __future__ import annotations

import json
import os
from pathlib import Path

from envgs_bench.regular_file import read_regular_text

LIST = "assets/files.json"
MOST_BYTES = 10_000_000  # of the list
FOLDERS = ("assets", "charts", "pictures")  # what a report has below its own folder


def delete_last_report(out: Path) -> None:
    """Delete what the last report wrote into `out`, and nothing else: the folder may hold other things too."""
    try:
        listed = json.loads(read_regular_text(out / LIST, MOST_BYTES))
    except (OSError, ValueError, RecursionError):
        return
    root = out.resolve()
    for name in listed if isinstance(listed, list) else []:
        path = out / str(name)
        if os.path.isfile(path) and path.parent.resolve().is_relative_to(root):  # for too long a name False, no error
            path.unlink()
            for folder in path.relative_to(out).parents[:-1]:
                if not any((out / folder).iterdir()):
                    (out / folder).rmdir()


def list_new_files(out: Path, before: set[Path]) -> None:
    """List the files of the report in `out` that were not there `before`."""
    new = sorted(str(path.relative_to(out)) for path in files_below(out) - before)
    (out / LIST).write_text(json.dumps([*new, LIST], indent=0), encoding="utf-8")


def files_below(out: Path) -> set[Path]:
    """The files in `out` and in the folders that reports have; runs may lie in `out` too."""
    found = [path for name in FOLDERS for path in (out / name).rglob("*")]
    return {path for path in (*out.glob("*"), *found) if path.is_file()}
