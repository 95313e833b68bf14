"""Which files a report is made of, so that the next one in the same folder leaves none of them behind."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from envgs_bench.regular_file import read_regular_text, require_regular

PAGE_NAME = "index.html"
OURS, HEAD_BYTES = b"<title>envgs-bench report</title>", 4096  # stands where every page of a report begins
LIST = "assets/files.json"
MOST_BYTES = 10_000_000  # of the list
FOLDERS = ("assets", "charts", "pictures")  # what a report has below its own folder


def require_no_others_page(out: Path) -> None:
    """Raise a ValueError where a report in `out` would replace a page that is none of ours."""
    try:
        require_regular(out / PAGE_NAME)
        with (out / PAGE_NAME).open("rb") as stream:
            beginning = stream.read(HEAD_BYTES)
    except (FileNotFoundError, NotADirectoryError):
        return
    if beginning and OURS not in beginning:
        raise ValueError(
            f"{out}: holds an {PAGE_NAME} of something else, which a report would replace; give a new folder"
        )


@contextmanager
def in_place_of_the_last(out: Path) -> Iterator[None]:
    """What is written into `out` within is the report there; what else the last one wrote is deleted in the end.

    So there is a page at every moment, and other things that the folder holds stay.
    """
    (out / LIST).parent.mkdir(parents=True, exist_ok=True)
    last = _listed(out)
    (out / LIST).write_text(json.dumps(sorted(last), indent=0), encoding="utf-8")
    began = (out / LIST).stat().st_ctime_ns  # of the clock that files have
    yield
    new = {str(path.relative_to(out)) for path in _files_below(out) if path.stat().st_ctime_ns >= began}
    (out / LIST).write_text(json.dumps(sorted(new | {LIST}), indent=0), encoding="utf-8")
    _delete(out, last - new - {LIST})


def _listed(out: Path) -> set[str]:
    """The files that the last report in `out` was made of, relative to it."""
    try:
        listed = json.loads(read_regular_text(out / LIST, MOST_BYTES))
    except (OSError, ValueError, RecursionError):
        return set()
    return set(map(str, listed)) if isinstance(listed, list) else set()


def _delete(out: Path, names: Iterable[str]) -> None:
    root = out.resolve()
    for path in (out / name for name in names):
        if os.path.isfile(path) and path.parent.resolve().is_relative_to(root):  # for too long a name False, no error
            path.unlink()
            for folder in path.relative_to(out).parents[:-1]:
                if not any((out / folder).iterdir()):
                    (out / folder).rmdir()


def _files_below(out: Path) -> set[Path]:
    """The files in `out` and in the folders that reports have; runs may lie in `out` too."""
    found = [path for name in FOLDERS for path in (out / name).rglob("*")]
    return {path for path in (*out.glob("*"), *found) if path.is_file()}
