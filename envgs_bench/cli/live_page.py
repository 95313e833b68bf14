"""Live page: the report on a sweep's runs while it is under way, in the folder that `page=` names."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

from envgs_bench.file_lock import one_at_a_time

PAGE_VARIABLE = "ENVGS_BENCH_PAGE"  # the folder, for all processes that run jobs of this call
LOADS_AGAIN = '<meta http-equiv="refresh" content="5">'
FIRST = f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8">{LOADS_AGAIN}<title>envgs-bench report</title></head>
<body><p>No run has ended yet: tables, charts and pictures come with the first.</p></body></html>
"""


def begin_page(folder: Path) -> None:
    """Have every job of this call renew the page there, and say where it is."""
    os.environ[PAGE_VARIABLE] = str(folder)
    page = folder / "index.html"
    folder.mkdir(parents=True, exist_ok=True)
    if not page.exists():
        page.write_text(FIRST, encoding="utf-8")
    print(f"the page fills as runs end: {page}", file=sys.stderr)


def renew_page(runs_dir: Path, under_way: Callable[[], str]) -> None:
    """Write the page of what there is now, where this call has one. One that cannot be written stops no run.

    Args:
        under_way: how far the sweep has come when the page is written; "" where it has ended.
    """
    if PAGE_VARIABLE not in os.environ:
        return
    folder = Path(os.environ[PAGE_VARIABLE])
    try:
        from envgs_bench.reports import build_report

        with one_at_a_time(folder / "page.lock"):
            build_report(runs_dir, folder, under_way=under_way())
    except Exception as error:
        print(f"the page in {folder} could not be written: {error}", file=sys.stderr)


def end_page(runs_dir: Path) -> Path | None:
    """The page of this call, which has ended, however: it waits for no more runs. None where it has no page."""
    folder = os.environ.get(PAGE_VARIABLE)
    page = Path(folder or "") / "index.html"
    if folder and page.is_file() and LOADS_AGAIN in page.read_text(encoding="utf-8", errors="replace"):
        renew_page(runs_dir, lambda: "")
        if page.read_text(encoding="utf-8", errors="replace") == FIRST:  # of no runs there is no page
            page.unlink()
    os.environ.pop(PAGE_VARIABLE, None)
    return page if folder and page.is_file() else None
