"""Times beside what is wanted: a table whose first rows miss it by most."""

from __future__ import annotations

from pathlib import Path

import pytest

from envgs_bench.reports.documentation import fill_page
from envgs_bench.reports.kept.runs_file import RunsFileError

HEAD = "what,primitives,size,measured,wanted,unit,device,commit\n"
ROWS = (
    "a step,300000,,14.3,,ms,H200,abc\n"
    "a frame,2000000,1292×839,4.996,5,ms,H200,abc\n"
    "a run,,540×960,75.04,40,s,H200,abc\n"
    "color,300000,1292×839,0.39,0.27,ms,H100,def\n"
)


def filled(folder: Path, content: str) -> str:
    (folder / "speed.csv").write_text(content, encoding="utf-8")
    page = folder / "page.md"
    page.write_text("<!-- table: speed records=speed.csv -->\nold\n<!-- end of table -->\n", encoding="utf-8")
    return fill_page(page, folder)[0]


def test_what_misses_by_most_comes_first_and_what_has_no_goal_last(tmp_path: Path) -> None:
    lines = [line for line in filled(tmp_path, HEAD + ROWS).splitlines() if line.startswith("| ")]
    assert [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]] == [
        ["a run", "540×960", "", "75 s, missed", "40 s"],
        ["color", "1292×839", "300000", "0.39 ms, missed", "0.27 ms"],
        ["a frame", "1292×839", "2000000", "5 ms", "5 ms"],
        ["a step", "", "300000", "14.3 ms", "–"],
    ]


def test_the_caption_says_where_and_of_which_commits(tmp_path: Path) -> None:
    caption = "*H100, commit `def`; H200, commit `abc`, nothing else on that GPU. Source: `"
    assert caption in filled(tmp_path, HEAD + ROWS)


@pytest.mark.parametrize("content", ["what,measured\na,1\n", HEAD + "a,,,soon,1,s,H200,abc\n"])
def test_another_file_is_refused(tmp_path: Path, content: str) -> None:
    with pytest.raises(RunsFileError, match="measured"):
        filled(tmp_path, content)
