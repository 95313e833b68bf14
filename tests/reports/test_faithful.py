"""The page that holds published methods against their authors' code: its table is made of the kept marks of both."""

from __future__ import annotations

import csv
from collections import defaultdict
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "envgs_bench" / "docs"
PAGE = (DOCS / "reference" / "faithful.md").read_text(encoding="utf-8")
CLOSE_DB, CLOSE_SHARE = 0.3, 0.1


def compared() -> dict[tuple[str, str], tuple[dict[str, str], dict[str, str]]]:
    """The original's and our mark at the last step that both have, by method and scene."""
    with (DOCS / "records" / "originals.csv").open(encoding="utf-8", newline="") as stream:
        marks = list(csv.DictReader(stream))
    found: dict[tuple[str, str], dict[str, dict[int, dict[str, str]]]] = defaultdict(lambda: defaultdict(dict))
    for mark in marks:
        found[mark["method"], mark["scene"]][mark["program"]][int(mark["steps"])] = mark
    pairs = {}
    for key, sides in found.items():
        last = max(sides["original"].keys() & sides["ours"].keys())
        pairs[key] = sides["original"][last], sides["ours"][last]
    return pairs


def row_of(original: dict[str, str], ours: dict[str, str]) -> str:
    """The table's line of a pair."""
    gain = float(ours["psnr"]) - float(original["psnr"])
    more = int(ours["primitives"]) / int(original["primitives"]) - 1
    close = [name for name, far in (("dB", abs(gain) > CLOSE_DB), ("primitives", abs(more) > CLOSE_SHARE)) if far]
    cells = [
        f"[`{original['method']}`](rivals.md)"
        if original["method"] != "2dgs"
        else "[`2dgs`](deviations.md#3dgs-and-2dgs)",
        f"`{original['commit']}`",
        f"`{original['scene']}`",
        f"{int(original['steps']):,}",
        f"{float(original['psnr']):.2f}",
        f"{float(ours['psnr']):.2f}",
        f"{int(original['primitives']):,}",
        f"{int(ours['primitives']):,}",
        f"{float(original['seconds']):.0f}",
        f"{float(ours['seconds']):.0f}",
        f"not yet: {', '.join(close)}" if close else "yes",
    ]
    return f"| {' | '.join(cells)} |"


@pytest.mark.parametrize("key", sorted(compared()), ids="-".join)
def test_the_page_has_each_comparison_as_it_was_measured(key: tuple[str, str]) -> None:
    assert row_of(*compared()[key]) in PAGE.splitlines()


def test_the_page_has_no_other_comparison() -> None:
    lines = [line for line in PAGE.splitlines() if line.startswith("| [`") and line.count("|") == 12]
    assert len(lines) == len(compared())
    assert all(original["seed"] == ours["seed"] for original, ours in compared().values())
