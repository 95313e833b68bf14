"""Records that anybody may have written: each is read apart from the others, and what it says stays text."""

from __future__ import annotations

import copy
import csv
import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from damaged_files import write_promising_png
from hypothesis import given, settings
from hypothesis import strategies as st
from reports_runs import chapter, record, run_folder, write_record, write_runs

from envgs_bench.cli.main import main
from envgs_bench.reports import build_report
from envgs_bench.reports.numbers.runs import read_runs
from envgs_bench.reports.page.html import PageSection, write_page
from envgs_bench.reports.pictures.gallery import galleries
from envgs_bench.reports.report import studies_of
from envgs_bench.reports.studies.ablation_ladder.chart import steps
from envgs_bench.reports.studies.ablation_ladder.study import AblationLadders
from envgs_bench.reports.studies.study import Drawn, has_page, page_part
from envgs_bench.reports.tables.latex import latex
from envgs_bench.reports.tables.markdown import markdown
from envgs_bench.reports.tables.sections import split_sections
from envgs_bench.reports.tables.structured import structured


def spoiled(**changes: Any) -> str:
    return json.dumps(record("toy/chrome_room", "envgs", 7) | changes)


def with_psnr(value: str) -> str:
    return spoiled(metrics={"mean": {"psnr": "PSNR"}, "per_view": [], "not_computed": {}}).replace('"PSNR"', value)


def with_cards(cards: dict[str, Any]) -> dict[str, Any]:
    return record("toy/chrome_room", "envgs", 0)["metrics"] | {"cards": cards}


CARD = {"title": "PSNR", "places": 2, "better": "higher"}
WHOLE = spoiled()
BAD = {  # what record.json holds -> what the report says of it
    "nested": ("[" * 50_000 + "]" * 50_000, "not a record: maximum recursion depth"),
    "nested within": (WHOLE.replace('"steps": 1500', f'"steps": {"[" * 50_000}{"]" * 50_000}'), "recursion"),
    "digits": (WHOLE.replace('"seed": 7', f'"seed": {"7" * 5000}'), "not a record: Exceeds the limit"),
    "seed": (WHOLE.replace('"seed": 7', '"seed": 1' + "0" * 30), "seed: Input should be less than 4294967296"),
    "no data set": (spoiled(config={"dataset": None}), "config: Value error, dataset is no JSON object"),
    "no method": (spoiled(config={"method": [1]}), "config: Value error, method is no JSON object"),
    "psnr": (with_psnr("1e308"), "metrics.mean.psnr: Input should be less than or equal to 1000000000000000000"),
    "nan": (with_psnr("NaN"), "metrics.mean.psnr: Input should be a finite number"),
    "metric": (spoiled(metrics=with_cards({"../psnr": CARD})), "metrics.cards.../psnr.[key]: String should match"),
    "places": (
        spoiled(metrics=with_cards({"psnr": CARD | {"places": 10**9}})),
        "metrics.cards.psnr.places: Input should",
    ),
    "count": (
        WHOLE.replace('"skipped_steps": 0', '"skipped_steps": 1' + "0" * 25),
        "cost.skipped_steps: Input should be",
    ),
    "escape": (spoiled(**{"\x1b[31m" + "k" * 10_000: 1}), "?[31m" + "k" * 95 + "…: Extra inputs"),
    "empty": ("", "not valid JSON (truncated?)"),
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Whole runs, and one of each kind that is not; not to be changed."""
    folder = tmp_path_factory.mktemp("hostile") / "runs"
    write_runs(folder, methods=("2dgs", "envgs"), seeds=(0, 1))
    for name, (content, _) in BAD.items():
        (folder / "bad" / name).mkdir(parents=True)
        (folder / "bad" / name / "record.json").write_text(content)
    (folder / "bad/pipe").mkdir()
    os.mkfifo(folder / "bad/pipe/record.json")
    return folder


def test_bad_records_are_named_and_the_others_reported(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(runs), "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr()
    assert f"4 runs, {len(BAD) + 1} unreadable" in said.out
    *complaints, helps = said.err.splitlines()
    assert helps.startswith("what helps: ")
    lines = dict(line.split(": ", 1)[1].split(": ", 1) for line in complaints)
    for name, (_, why) in BAD.items():
        reason = lines[str(runs / "bad" / name)]
        assert str(runs / "bad" / name / "record.json") in reason
        assert why in reason
        assert len(reason) < 1000
    assert "it is a named pipe, expected a file" in lines[str(runs / "bad/pipe")]
    page = (tmp_path / "out/index.html").read_text()
    assert all(f"bad/{name}" in page for name in BAD)


def test_views_that_no_file_is_called_after_are_shown_without_pictures(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", methods=("envgs",), seeds=(0,))
    content = record("toy/chrome_room", "envgs", 1)
    for view, name in zip(content["metrics"]["per_view"], ("v" * 300, "../../secret", "a\0b", "ä" * 150), strict=False):
        view["view"] = name
    folder = run_folder(tmp_path / "runs", "toy/chrome_room", "envgs", 1)
    write_record(folder, content)
    report = build_report(tmp_path / "runs", tmp_path / "out")
    assert len(report.sections[0].runs) == 2
    (gallery,) = galleries(report.sections[0])
    assert {shot.view for shot in gallery.shots} <= {f"{index:03d}" for index in range(5)}


def test_pictures_that_promise_gigabytes_are_shown_as_unreadable(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", methods=("2dgs", "envgs"), seeds=(0,))
    for path in (tmp_path / "runs").rglob("renders/00[01].png"):
        write_promising_png(path)
    for path in (tmp_path / "runs").rglob("layers/beta/*.png"):
        path.unlink()
        os.mkfifo(path)
    for path in (tmp_path / "runs").rglob("curve.csv"):
        path.unlink()
        os.mkfifo(path)
    report = build_report(tmp_path / "runs", tmp_path / "out")
    assert len(report.sections[0].runs) == 2
    assert list((tmp_path / "out/pictures").rglob("*worst*.png"))


def test_a_link_in_a_runs_folder_brings_no_other_file_into_the_report(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("secret")
    write_runs(tmp_path / "runs", methods=("envgs",), seeds=(0,))
    linked = [*(tmp_path / "runs").rglob("layers/beta/*.png"), *(tmp_path / "runs").rglob("renders/001.png")]
    for path in linked:
        path.unlink()
        path.symlink_to(tmp_path / "secret")
    build_report(tmp_path / "runs", tmp_path / "out")
    copied = [path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert len(linked) == 6
    assert b"secret" not in copied


@pytest.mark.parametrize("listed", ["[" * 50_000, '["' + "x" * 5000 + '", "a\\u0000b", "../../keep", 5]'])
def test_a_list_of_files_that_no_report_wrote_deletes_nothing(tmp_path: Path, listed: str) -> None:
    write_runs(tmp_path / "runs", methods=("envgs",), seeds=(0,), pictures=False)
    (tmp_path / "keep").touch()
    (tmp_path / "runs/report/assets").mkdir(parents=True)
    (tmp_path / "runs/report/assets/files.json").write_text(listed)
    build_report(tmp_path / "runs", tmp_path / "runs/report")
    assert (tmp_path / "keep").exists()


def test_a_curve_beyond_all_numbers_leaves_its_points_out(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", methods=("envgs",), seeds=(0, 1), pictures=False)
    for path in (tmp_path / "runs").rglob("curve.csv"):
        path.write_text("step,seconds,psnr\n1,1,20\n2,1e308,1e308\n1e300,3,30\n3,4,25\n")
    build_report(tmp_path / "runs", tmp_path / "out")
    curves = (tmp_path / "out/assets/curves-0-0.js").read_text()
    assert '"step":[1.0,2.0,3.0]' in curves
    assert '"mean":[20.0,null,25.0]' in curves


@pytest.mark.filterwarnings("ignore:Glyph")  # that charts' font has no control characters
@pytest.mark.parametrize(
    "start", ["\x1b[2J=", *(pytest.param(start, marks=pytest.mark.slow) for start in ["=", "+", "-", "@", "\t=", " ="])]
)
def test_what_a_record_says_is_no_formula_and_no_escape_sequence(tmp_path: Path, start: str) -> None:
    name = f"{start}1+1"
    hostile = record("toy/chrome_room", "envgs", 0) | {"method": name, "dataset": f"{start}cmd"}
    hostile["metrics"]["mean"][f"{start}SUM"] = 1.0
    write_record(tmp_path / "runs/a", hostile)
    negative = record("toy/chrome_room", "envgs", 0)
    negative["metrics"]["mean"]["psnr"] = -3.5
    write_record(tmp_path / "runs/b", negative)
    sections = build_report(tmp_path / "runs", tmp_path / "out").sections
    with (tmp_path / "out/table.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    words = {row[column] for row in rows for column in ("dataset", "method", "region", "metric")}
    assert {"envgs", "toy/chrome_room", "psnr"} < words
    assert not {word for word in words if word.startswith(("=", "+", "-", "@")) or not word.isprintable()}
    assert "-3.5" in {row["value"] for row in rows}  # a number stays one
    for text in ((tmp_path / "out" / "table.md").read_text(), latex(list(map(chapter, sections)))):
        assert all(line.isprintable() for line in text.split("\n"))


# What a key of a record may be given: wrong types, numbers beyond all bounds, names that are no file's.
NUMBERS = [-1, 0.5, 2**31, 10**30, 1e308, -1e308, 1e17, 5e-324]
TEXTS = ["", "x" * 300, "../up", "=1", "\x1b[31m", "\0", "nan", "1e999", "9" * 400, r"$\frac{$"]
PARTS = [None, True, [], {}, [None], {"a": None}, [[[]]], {"kind": 5}, {"name": ["x"]}, {"": ""}]
ODD = st.sampled_from([*NUMBERS, *TEXTS, *PARTS])


def places(node: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The keys that lead to each part of some JSON content."""
    if at:
        yield at
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in items:
        yield from places(value, (*at, key))


def within_budget(primitives: int) -> dict[str, Any]:
    content = record("toy/chrome_room", "envgs", 0)
    content["config"]["budget"] = {"primitives": primitives, "mb": None}
    content["metrics"] = with_cards({"psnr": CARD, "frame_ms": CARD})  # the latter is another column's name
    return content


@st.composite
def damaged(draw: st.DrawFn) -> dict[str, Any]:
    """A record with up to three of its parts replaced or deleted."""
    content = copy.deepcopy(within_budget(500))
    for _ in range(draw(st.integers(1, 3))):
        *above, last = draw(st.sampled_from(sorted(places(content), key=str)))
        node = content
        for key in above:
            node = node[key]
        if draw(st.integers(0, 4)):
            node[last] = copy.deepcopy(draw(ODD))
        else:
            del node[last]
    return content


@settings(max_examples=25, deadline=None, derandomize=True)
@given(damaged())
def test_a_record_with_anything_in_it_is_refused_or_reported(content: dict[str, Any]) -> None:
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_record(folder / "runs/a", content)
        write_record(folder / "runs/b", record("toy/chrome_room", "2dgs_tuned", 0))
        write_record(folder / "runs/c", within_budget(1000))
        found, broken = read_runs(folder / "runs")
        assert len(found) + len(broken) == 3
        sections = split_sections(found)
        (folder / "out").mkdir()
        chapters = list(map(chapter, sections))
        json.dumps(structured(chapters, broken), allow_nan=False)
        assert all(line.isprintable() for line in markdown(chapters, broken).split("\n"))
        assert latex(chapters).isascii()
        shown = []
        for own in chapters:
            parts = []
            for study in studies_of(own.section):
                files = {name: f"{name}.csv" for name in study.csv()}
                if isinstance(study, AblationLadders):
                    assert all(math.isfinite(step.level) for ladder in study.ladders for step in steps(ladder))
                if has_page(type(study)):
                    parts.append(page_part(study, Drawn(), files, folder / "out"))
            shown.append(PageSection(own, galleries(own.section), parts))
        write_page(folder / "out", shown, broken, [], for_print=False, under_way="")


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.binary(max_size=200), st.integers(0, len(WHOLE)), st.integers(0, 40))
def test_any_bytes_in_a_record_are_refused_by_name(noise: bytes, start: int, length: int) -> None:
    with TemporaryDirectory() as name:
        path = Path(name) / "record.json"
        whole = WHOLE.encode()
        path.write_bytes(whole[:start] + noise + whole[start + length :])
        runs, broken = read_runs(Path(name))
        assert len(runs) + len(broken) == 1
        assert all(str(path) in item.reason and len(item.reason) < 2000 for item in broken)
