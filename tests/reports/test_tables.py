"""The reports' tables: what a cell says, which runs share a table, and that every format prints the same."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
from decimal import Decimal
from pathlib import Path

import pandas as pd
import pytest
from reports_runs import (
    METHODS,
    VIEWS,
    chapter,
    record,
    row_of,
    run_folder,
    sections_of,
    tables_of,
    titled,
    titles,
    write_failure,
    write_record,
    write_runs,
)

from envgs_bench.cli.main import main
from envgs_bench.records import RecordError
from envgs_bench.reports.numbers.cards import KNOWN
from envgs_bench.reports.numbers.decimals import mean, rounded
from envgs_bench.reports.numbers.estimates import Numbers
from envgs_bench.reports.report import build_report
from envgs_bench.reports.tables.columns import main_columns, over
from envgs_bench.reports.tables.entries import entries
from envgs_bench.reports.tables.latex import latex
from envgs_bench.reports.tables.markdown import markdown
from envgs_bench.reports.tables.notes import caption, notes
from envgs_bench.reports.tables.sections import Section
from envgs_bench.reports.tables.structured import structured
from envgs_bench.reports.tables.table import Table, build_table

ROOM = "toy/chrome_room"


@pytest.fixture(autouse=True)
def no_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Charts have tests of their own, and take their time."""
    monkeypatch.setattr("envgs_bench.reports.report.draw_charts", lambda *_, **__: [])


def table_of(scores: dict[str, list[float | None]], metric: str = "psnr", attempts: int | None = None) -> Table:
    """One data set's table of one metric, from the values of each method over seeds."""
    tidy = [(ROOM, m, s, "full", metric, v) for m, values in scores.items() for s, v in enumerate(values)]
    runs = [
        (ROOM, m, s, "ok" if s < len(v) else "failed") for m, v in scores.items() for s in range(attempts or len(v))
    ]
    frame = pd.DataFrame(tidy, columns=["dataset", "method", "seed", "region", "metric", "value"])
    tried = pd.DataFrame(runs, columns=["dataset", "method", "seed", "status"])
    return build_table(
        Numbers(frame.astype({"value": float}), tried), ROOM, "subject", over((ROOM,), main_columns(KNOWN)), scores
    )


# ------------------------------------------------------------------------------------- means, intervals and ranks


@pytest.mark.parametrize(("value", "places", "text"), [("2.675", 2, "2.68"), ("0.0005", 3, "0.001"), ("-1.5", 0, "-2")])
def test_halves_round_away_from_zero(value: str, places: int, text: str) -> None:
    assert str(rounded(value, places)) == text
    assert str(rounded(float(value), places)) == text


def test_a_mean_is_exact_in_decimals() -> None:
    assert mean([0.1, 0.2]) == Decimal("0.15")
    assert rounded(mean([26.21, 26.215]), 2) == Decimal("26.21")  # 26.2125
    with pytest.raises(ValueError, match="no values"):
        mean([])


def test_ranks_are_of_printed_numbers_and_ties_share_them() -> None:
    table = table_of({"a": [27.004], "b": [26.996], "c": [26.5], "d": [26.4], "e": [26.4]})
    assert [row.cells["psnr"].text for row in table.rows] == ["27.00", "27.00", "26.50", "26.40", "26.40"]
    assert [row.cells["psnr"].rank for row in table.rows] == [1, 1, 3, None, None]


def test_lower_is_better_for_error_metrics() -> None:
    table = table_of({"a": [0.2], "b": [0.1], "c": [0.3]}, metric="flip")
    assert [row.cells["flip"].rank for row in table.rows] == [2, 1, 3]


def test_a_lone_method_has_no_rank() -> None:
    assert table_of({"a": [27.0]}).rows[0].cells["psnr"].rank is None


def test_what_the_same_seeds_do_not_show_to_be_worse_than_the_best_is_marked() -> None:
    table = table_of({"a": [27.0, 27.2, 27.4], "b": [26.9, 27.3, 27.1], "c": [26.9, 27.1, 27.29]})
    assert [row.cells["psnr"].tied for row in table.rows] == [False, True, False]  # c: 0.10 below in each
    assert table.rows[0].cells["psnr"].text == "27.20 ± 0.20"
    assert entries(table, table.rows[1])[2].marked == "27.10 ± 0.20² ≈"


def test_an_ablation_is_a_difference_on_the_same_seed(tmp_path: Path) -> None:
    """Seeds differ by more than variants do: pairing them is what shows the part's worth."""
    for seed, level in enumerate((20.0, 25.0, 30.0)):
        for method, drop in (("envgs", 0.0), ("envgs_no_joint", 0.5 + 0.1 * seed)):
            content = record(ROOM, method, seed)
            content["metrics"]["mean"]["psnr"] = level - drop
            write_record(tmp_path / f"{method}-{seed}", content)
    table = titled(sections_of(tmp_path)[0], f"{ROOM}: envgs and what it is without")
    assert [row.method for row in table.rows] == ["envgs_no_joint", "envgs"]
    assert row_of(table, "envgs_no_joint").cells["psnr - envgs"].text == "−0.60 ± 0.10"
    assert row_of(table, "envgs").cells["psnr - envgs"].text == "+0.00"


def test_rows_that_failed_somewhere_compete_for_nothing() -> None:
    table = table_of({"good": [27.0, 27.1], "lucky": [30.0], "bad": [25.0, 25.0]}, attempts=2)
    assert [row.cells["psnr"].rank for row in table.rows] == [1, None, 2]
    assert row_of(table, "lucky").runs_text == "1/2: 1 failed"


def test_what_could_not_be_computed_is_neither_zero_nor_nan() -> None:
    cell = table_of({"a": [None], "b": [0.2]}, metric="lpips").rows[0].cells["lpips"]
    assert (cell.text, cell.mean, cell.rank) == ("n/c", None, None)


def test_averages_are_over_complete_rows_only(tmp_path: Path) -> None:
    write_runs(tmp_path, (ROOM, "toy/sky_ball"), ("3dgs", "envgs"), seeds=(0, 1), pictures=False)
    write_failure(tmp_path, "toy/sky_ball", "envgs", 1, "timeout", "60 minutes")
    section = sections_of(tmp_path)[0]
    average = titled(section, "toy")
    assert row_of(average, "envgs").cells["psnr"].text == "— (1/2)"
    assert row_of(average, "envgs").cells["psnr"].rank is None
    expected = section.tidy.query("method == '3dgs' and metric == 'psnr' and region == 'full'")
    by_hand = expected.groupby("dataset")["value"].mean().mean()
    assert float(row_of(average, "3dgs").cells["psnr"].mean or 0) == pytest.approx(by_hand, abs=1e-12)


# ------------------------------------------------------------------------------------------- records into sections


def other_protocol() -> dict[str, str]:
    return {"name": "strict", "hash": "0123", "description": "8 bits"}


def test_the_tidy_table_has_exactly_its_columns_and_the_records_numbers(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", seeds=(0, 1), pictures=False)
    build_report(tmp_path / "runs", tmp_path / "out")
    with (tmp_path / "out/table.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["dataset", "method", "seed", "region", "metric", "value"]
    found = {(r["method"], r["seed"], r["region"], r["metric"]): r["value"] for r in rows}
    truth = record(ROOM, "envgs", 1)
    assert float(found["envgs", "1", "full", "psnr"]) == truth["metrics"]["mean"]["psnr"]
    assert float(found["envgs", "1", "near_field", "psnr"]) == truth["masked"]["near_field"]["psnr"]
    assert float(found["envgs", "1", "reflective", "fraction"]) == 0.18
    assert float(found["envgs", "1", "full", "primitives_env"]) == truth["cost"]["primitives"]["env"]
    assert float(found["envgs", "1", "full", "frame_ms"]) == truth["timing"]["frame_ms"]
    assert found["envgs", "1", "full", "lpips"] == ""
    assert {r["method"] for r in rows} == set(METHODS)


def test_protocols_and_devices_never_share_a_table(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", pictures=False)
    write_runs(tmp_path / "runs/b", seeds=(0, 1), pictures=False, protocol=other_protocol())
    elsewhere = record(ROOM, "envgs", 0)["provenance"] | {"device": {"type": "cuda", "name": "made-up GPU"}}
    write_runs(tmp_path / "runs/c", seeds=(0,), pictures=False, provenance=elsewhere)
    sections = sections_of(tmp_path / "runs")
    assert [(s.protocol.name, s.device, len(s.runs)) for s in sections] == [
        ("envgs", "made-up CPU, 2 threads", 12),
        ("strict", "made-up CPU, 2 threads", 8),
        ("envgs", "made-up GPU", 4),
    ]
    assert all(row.attempts == 3 for table in sections[0].tables for row in table.rows)
    build_report(tmp_path / "runs", tmp_path / "out")
    lengths = {path.name: len(path.read_text().splitlines()) for path in (tmp_path / "out").glob("table*.csv")}
    assert sorted(lengths) == sorted(s.csv_name(i) for i, s in enumerate(sections))
    assert lengths["table.csv"] == 1 + len(sections[0].tidy)


def test_repaired_and_unrepaired_runs_never_share_a_table(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", pictures=False)
    write_runs(tmp_path / "runs/b", seeds=(0, 1), pictures=False, repair=["exposures", "normals"])
    sections = sections_of(tmp_path / "runs")
    assert [(s.repair, len(s.runs)) for s in sections] == [((), 12), (("exposures", "normals"), 8)]
    assert len({section.slug for section in sections}) == 2
    for text in (sections[1].title, sections[1].short, markdown(list(map(chapter, sections)), [])):
        assert "repair of exposures and normals" in text
    assert "repair" not in sections[0].title


def test_test_and_validation_views_never_share_a_table(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", pictures=False)
    write_runs(tmp_path / "runs/b", seeds=(0, 1), pictures=False, scored_on="validation")
    sections = sections_of(tmp_path / "runs")
    assert [(s.scored_on, len(s.runs)) for s in sections] == [("test", 12), ("validation", 8)]
    assert all(row.attempts == 3 for table in sections[0].tables for row in table.rows)
    test, validation = (caption(section, titled(section, ROOM)) for section in sections)
    assert f"{VIEWS} test views" in test
    assert f"{VIEWS} validation views" in validation
    for text in (sections[1].title, sections[1].short, markdown(list(map(chapter, sections)), [])):
        assert "validation views" in text
    assert sections[0].csv_name(1) != sections[1].csv_name(1)


def test_pictures_from_elsewhere_stand_beside_every_device_without_times(tmp_path: Path) -> None:
    write_runs(tmp_path / "cpu", pictures=False)
    gpu = record(ROOM, "envgs", 0)["provenance"] | {"device": {"type": "cuda", "name": "made-up GPU"}}
    write_runs(tmp_path / "gpu", seeds=(0,), pictures=False, provenance=gpu)
    other = record(ROOM, "zipnerf", 0, kind="renders", timing=None, cost=None, steps=0)
    write_record(tmp_path / "zipnerf", other)
    sections = sections_of(tmp_path)
    assert [(s.device, len(s.runs)) for s in sections] == [("made-up CPU, 2 threads", 13), ("made-up GPU", 5)]
    for section in sections:
        row = row_of(titled(section, ROOM), "zipnerf")
        assert row.cells["psnr"].text != "—"
        assert [row.cells[key].text for key in ("frame_ms", "train_seconds", "primitives", "model_bytes")] == ["—"] * 4
    write_record(tmp_path / "alone" / "zipnerf", other)
    (alone,) = sections_of(tmp_path / "alone")
    report = build_report(tmp_path / "alone", tmp_path / "out")
    assert [column.key for column in alone.tables[0].columns][:1] == ["psnr"]
    assert not (report.out / "pareto.png").exists()


def test_runs_with_different_settings_never_share_a_row(tmp_path: Path) -> None:
    for size in (128, 256):
        config = {"method": {"name": "envmap", "settings": {"envmap_size": size}}, "dataset": {"kind": "toy"}}
        for seed in (0, 1):
            write_record(tmp_path / f"{size}-{seed}", record(ROOM, "envmap", seed, config=config))
    write_runs(tmp_path, methods=("envgs",), seeds=(0,), pictures=False, config={"dataset": {"kind": "toy"}})
    section = sections_of(tmp_path)[0]
    assert section.methods == ["envmap [envmap_size=128]", "envmap [envmap_size=256]", "envgs"]
    assert [row.runs_text for row in section.tables[0].rows] == ["2/2", "2/2", "1/1"]


def test_runs_with_different_budgets_never_share_a_row(tmp_path: Path) -> None:
    for primitives in (None, 2000, 500):
        content = record("toy/chrome_room", "envgs", 0)
        content["config"] |= {"budget": {"primitives": primitives, "mb": None}} if primitives else {"budget": None}
        write_record(tmp_path / str(primitives), content)
    (section,) = sections_of(tmp_path)
    assert section.methods == ["envgs [primitives=500]", "envgs [primitives=2000]", "envgs [primitives=any]"]
    assert section.sweeps == [section.methods[:2]]


def test_data_of_another_size_is_another_data_set(tmp_path: Path) -> None:
    for views in (24, 48):
        config = {"method": {"name": "envgs"}, "dataset": {"kind": "toy", "views": views}}
        write_record(tmp_path / str(views), record(ROOM, "envgs", 0, config=config))
    assert sections_of(tmp_path)[0].datasets == [f"{ROOM} [views=24]", f"{ROOM} [views=48]"]


def test_the_newest_of_two_equal_runs_counts(tmp_path: Path) -> None:
    write_runs(tmp_path, methods=("envgs",), seeds=(0,), pictures=False)
    later = record(ROOM, "envgs", 0)
    later["provenance"]["finished"] = "2026-02-01T00:00:00+00:00"
    later["metrics"]["mean"]["psnr"] = 11.0
    write_record(tmp_path / "again", later)
    section = sections_of(tmp_path)[0]
    assert row_of(section.tables[0], "envgs").cells["psnr"].text == "11.00"
    assert len(section.superseded) == 1


def test_methods_come_in_a_fixed_order(tmp_path: Path) -> None:
    write_runs(tmp_path, methods=("zebra", "envgs", "envmap", "aardvark", "2dgs", "3dgs"), seeds=(0,), pictures=False)
    assert sections_of(tmp_path)[0].methods == ["3dgs", "2dgs", "envmap", "envgs", "aardvark", "zebra"]


def test_broken_records_are_listed_and_not_fatal(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", methods=("3dgs",), seeds=(0, 1), pictures=False)
    truncated = run_folder(tmp_path / "runs", ROOM, "3dgs", 1) / "record.json"
    truncated.write_text(truncated.read_text()[:200])
    killed = tmp_path / "runs" / ROOM / "2dgs" / "seed0-killed"
    killed.mkdir(parents=True)
    (killed / "config.yaml").write_text("method: {}\n")
    (killed / "log.txt").write_text("step 12\n")
    report = build_report(tmp_path / "runs", tmp_path / "out")
    assert {item.path for item in report.broken} == {truncated.parent, killed}
    assert "2 unreadable" in str(report)
    for name in ("table.md", "index.html"):
        text = (tmp_path / "out" / name).read_text()
        assert "truncated" in text
        assert "seed0-killed" in text


def test_a_rebuilt_report_leaves_nothing_of_the_last_one_and_nothing_else_goes(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", seeds=(0,))
    write_runs(tmp_path / "runs/strict", seeds=(0,), protocol=other_protocol())
    mine = tmp_path / "out/pictures/mine.png"
    mine.parent.mkdir(parents=True)
    mine.write_bytes(b"mine")
    (tmp_path / "out/runs").mkdir()
    build_report(tmp_path / "runs", tmp_path / "out")
    first = {path for path in (tmp_path / "out").rglob("*") if path.is_file()}
    shutil.rmtree(tmp_path / "runs/strict")
    waiting = build_report(tmp_path / "runs", tmp_path / "out", under_way="1 of <2>").page.read_text()
    assert '<meta http-equiv="refresh"' in waiting
    assert ">1 of &lt;2&gt;</p>" in waiting
    assert '<meta http-equiv="refresh"' not in build_report(tmp_path / "runs", tmp_path / "out").page.read_text()
    build_report(tmp_path / "runs", tmp_path / "fresh")
    second = {str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*") if path.is_file()}
    fresh = {str(path.relative_to(tmp_path / "fresh")) for path in (tmp_path / "fresh").rglob("*") if path.is_file()}
    assert second == fresh | {"pictures/mine.png"}
    assert len(second) < len(first)
    assert (tmp_path / "out/runs").is_dir()


def test_a_page_of_something_else_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_runs(tmp_path / "runs", methods=("3dgs",), seeds=(0,), pictures=False)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/index.html").write_text("my own page")
    assert main(["report", str(tmp_path / "runs"), "--out", str(tmp_path / "mine")]) == 1
    assert "mine: holds an index.html of something else, which a report would replace" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["index.html"]
    assert (tmp_path / "mine/index.html").read_text() == "my own page"
    assert main(["report", str(tmp_path / "mine/index.html")]) == 1
    assert "mine/index.html: no such folder; expected the runs_dir" in capsys.readouterr().err
    for _ in range(2):  # a report's own page is replaced
        assert main(["report", str(tmp_path / "runs"), "--out", str(tmp_path / "out")]) == 0


@pytest.mark.parametrize("listed", ['["../secret"]', '{"a": 1}', "[1, null]", "broken"])
def test_a_list_of_files_cannot_lead_out_of_the_report(tmp_path: Path, listed: str) -> None:
    write_runs(tmp_path / "runs", methods=("3dgs",), seeds=(0,), pictures=False)
    (tmp_path / "secret").write_text("kept")
    (tmp_path / "out/assets").mkdir(parents=True)
    (tmp_path / "out/assets/files.json").write_text(listed)
    build_report(tmp_path / "runs", tmp_path / "out")
    assert (tmp_path / "secret").read_text() == "kept"


def test_a_report_of_nothing_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no readable record.json under it: run `envgs-bench run` first"):
        build_report(tmp_path, tmp_path / "out")
    with pytest.raises(RecordError, match="no such folder"):
        build_report(tmp_path / "missing", tmp_path / "out")


def test_a_report_of_failures_alone_is_a_report(tmp_path: Path) -> None:
    write_failure(tmp_path / "runs", ROOM, "envgs", 0, "out_of_memory", "tried to allocate 12 GB")
    report = build_report(tmp_path / "runs", tmp_path / "out")
    assert not (tmp_path / "out/pareto.png").exists()
    assert "tried to allocate 12 GB" in report.page.read_text()
    assert "0/1: 1 out of memory" in (tmp_path / "out/table.md").read_text()


# -------------------------------------------------------------------------------------------- one table, all formats


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Section:
    folder = tmp_path_factory.mktemp("mixed")
    write_runs(folder, (ROOM, "toy/diffuse_room"), pictures=False)
    write_failure(folder, ROOM, "envmap", 2, "diverged", "loss is nan | <b>_x_</b>")
    return sections_of(folder)[0]


def plain(text: str) -> str:
    """The number in a Markdown or LaTeX cell, without its marks."""
    text = re.sub(r"\\(best|second|third)\{(.*?)\}(?= |$)", r"\2", text.strip().removesuffix(r"\\").strip())
    for markup, character in ((r"$\pm$", "±"), ("$-$", "−"), ("---", "—"), (r"$\approx$", ""), ("\\_", "_")):
        text = text.replace(markup, character)
    return re.sub(r"[*¹²³≈]", "", text).strip()


def test_every_format_prints_the_same_numbers(mixed: Section) -> None:
    expected = [
        [plain(entry.text) for entry in entries(table, row)] for table in tables_of(mixed) for row in table.rows
    ]
    pipes = [line for line in markdown([chapter(mixed)], []).splitlines() if line.startswith("| ")]
    cells = [[plain(cell) for cell in line.strip("| ").split(" | ")] for line in pipes]
    assert [line for line in cells if line[0] in METHODS] == expected
    lines = [line.split(" & ") for line in latex([chapter(mixed)]).splitlines() if line.endswith(r"\\")]
    assert [[plain(cell) for cell in line] for line in lines if plain(line[0]) in METHODS] == expected
    content = json.loads(json.dumps(structured([chapter(mixed)], [])))
    texts = [
        [row["method"], row["runs"], *(row["cells"][column["key"]]["text"] for column in table["columns"])]
        for table in content["sections"][0]["tables"]
        for row in table["rows"]
    ]
    assert texts == expected


def test_the_json_holds_what_stands_behind_a_number(mixed: Section) -> None:
    table = next(t for t in structured([chapter(mixed)], [])["sections"][0]["tables"] if t["title"] == ROOM)
    row = next(row for row in table["rows"] if row["method"] == "envgs")
    values = mixed.tidy.query(f"dataset == '{ROOM}' and method == 'envgs' and region == 'full'")
    megabytes = values.query("metric == 'model_bytes'")["value"] / 1e6
    cell = row["cells"]["model_bytes"]
    assert cell["mean"] == pytest.approx(megabytes.mean())
    assert cell["std"] == pytest.approx(megabytes.std(ddof=1))
    assert cell["interval"][0] <= cell["mean"] <= cell["interval"][1]
    assert cell["text"].startswith(f"{megabytes.mean():.1f}")


def test_what_training_views_show_is_the_first_region(tmp_path: Path) -> None:
    content = record(ROOM, "envgs", 0)
    content["masked"]["covisible"] = content["masked"]["reflective"] | {"psnr": 27.5, "fraction": 0.97}
    write_record(tmp_path / "0", content)
    (section,) = sections_of(tmp_path)
    table = titled(section, ROOM)
    regions = [title for title in titles(table) if title.startswith("PSNR ") and title != "PSNR ↑"]
    assert regions == ["PSNR covisible ↑", "PSNR reflective ↑", "PSNR near-field ↑"]
    assert row_of(table, "envgs").cells["psnr_covisible"].estimate.strata == ((27.5,),)


def test_region_tables_hold_the_masked_scores(mixed: Section) -> None:
    table = titled(mixed, f"{ROOM}: inside the regions")
    assert titles(table)[2:6] == ["near-field PSNR ↑", "near-field SSIM ↑", "near-field FLIP ↓", "near-field LPIPS ↓"]
    truth = [record(ROOM, "envgs", seed)["masked"]["reflective"]["psnr"] for seed in (0, 1, 2)]
    assert row_of(table, "envgs").cells["reflective: psnr_reflective"].estimate.strata == (tuple(truth),)
    assert "reflective 18.0% (7.4 dB)" in " ".join(notes(mixed, table))


def test_glass_has_a_column_and_a_region_of_ones_own_a_table(tmp_path: Path) -> None:
    content = record("toy/glass", "envgs", 0)
    scores = content["masked"]["reflective"]
    content["masked"] = {"transmissive": {**scores, "psnr": 21.5}, "varnish": {**scores, "psnr": 17.25}}
    write_record(tmp_path / "run", content)
    (section,) = sections_of(tmp_path)
    assert row_of(titled(section, "toy/glass"), "envgs").cells["psnr_transmissive"].estimate.strata == ((21.5,),)
    regions = titled(section, "toy/glass: inside the regions")
    assert row_of(regions, "envgs").cells["varnish: psnr_varnish"].estimate.strata == ((17.25,),)


def test_times_on_a_busy_machine_are_noted(tmp_path: Path) -> None:
    content = record(ROOM, "envgs", 0)
    content["provenance"]["machine"]["others_cores"] = 1.5
    write_record(tmp_path / "busy", content)
    (section,) = sections_of(tmp_path)
    assert "Others kept up to 1.5 processor cores busy" in " ".join(notes(section, section.tables[0]))


def test_what_runs_noted_and_warned_of_stands_below_the_table_of_their_data_set(tmp_path: Path) -> None:
    turned = "turns the normals of 42 of 42 training views"
    write_runs(tmp_path, (ROOM, "toy/sky_ball"), ("2dgs", "envmap"), pictures=False)
    write_runs(tmp_path, (ROOM,), ("envmap",), pictures=False, notes=[turned])
    for seed, step in ((0, 400), (2, 350)):
        warning = {"kind": "beta_vanishes", "step": step, "part": "", "message": f"a mean β of 0 since {step}"}
        write_runs(tmp_path, (ROOM,), ("envgs",), (seed,), pictures=False, notes=[turned], warnings=[warning])
    write_runs(tmp_path, (ROOM,), ("envgs",), (1,), pictures=False, notes=[turned])
    (section,) = sections_of(tmp_path)
    assert notes(section, titled(section, ROOM))[-2:] == [
        f"envmap, envgs: {turned}.",
        "envgs (2 of 3 runs): warning: beta vanishes: a mean β of 0 since 400.",
    ]
    for title in ("toy/sky_ball", "toy", f"{ROOM}: inside the regions"):
        assert not any(turned in note or "warning" in note for note in notes(section, titled(section, title)))


def test_data_that_changed_between_runs_are_told_below_their_table(tmp_path: Path) -> None:
    """A photograph was corrected after 2dgs and one seed of envmap: the others are no longer of the same data."""
    before, after = {"data": "0123456789abcdef"}, {"data": "fedcba9876543210"}
    write_runs(tmp_path, (ROOM, "toy/sky_ball"), ("2dgs", "envmap"), pictures=False, **before)
    write_runs(tmp_path, (ROOM,), ("envmap",), (1, 2), pictures=False, **after)
    write_runs(tmp_path, (ROOM,), ("envgs",), pictures=False, **after)
    (section,) = sections_of(tmp_path)
    (told,) = [note for note in notes(section, titled(section, ROOM)) if "changed between runs" in note]
    for methods in ("2dgs, envmap (1 of 3 runs)", "envmap (2 of 3 runs), envgs"):
        assert methods in told
    for title in ("toy/sky_ball", "toy", f"{ROOM}: inside the regions"):
        assert not any("changed between runs" in note for note in notes(section, titled(section, title)))


def test_views_that_one_seed_spoils_are_told_below_the_table_of_their_data_set(tmp_path: Path) -> None:
    """Of made-up views: 24.0 is 2 dB and more below both others in one seed, in another only below one of them."""
    psnr = {0: [30.0, 28.0, 24.0, 20.0, 25.0], 1: [27.9, 26.5, 26.1, 20.1, 25.0], 2: [30.1, 26.0, 26.1, 22.5, 19.0]}
    for method, seeds in (("envgs", (0, 1, 2)), ("2dgs", (0, 2))):
        for seed in seeds:
            content = record(ROOM, method, seed)
            content["metrics"]["per_view"] = [
                {"view": f"{i:03d}", "psnr": value, "ssim": 0.9, "flip": 0.1} for i, value in enumerate(psnr[seed])
            ]
            write_record(run_folder(tmp_path, ROOM, method, seed), content)
    (section,) = sections_of(tmp_path)
    assert [note for note in notes(section, titled(section, ROOM)) if "spoiled" in note] == [
        "envgs: 3 of 5 views spoiled by one seed, 2 dB and more below every other seed's: "
        "004 (seed 2 19.0 dB, others from 25.0), 000 (seed 1 27.9 dB, others from 30.0), "
        "002 (seed 0 24.0 dB, others from 26.1)."
    ]


def test_of_many_spoiled_views_the_worst_are_told(tmp_path: Path) -> None:
    for seed in (0, 1, 2):
        content = record(ROOM, "envgs", seed)
        content["metrics"]["per_view"] = [
            {"view": f"{i:03d}", "psnr": 30.0 - 3 * i * (seed == 1), "ssim": 0.9, "flip": 0.1} for i in range(7)
        ]
        write_record(run_folder(tmp_path, ROOM, "envgs", seed), content)
    (section,) = sections_of(tmp_path)
    (note,) = (note for note in notes(section, titled(section, ROOM)) if "spoiled" in note)
    assert note.startswith("envgs: 6 of 7 views")
    assert "'s: 006 (seed 1 12.0 dB, others from 30.0), 005 (seed 1 15.0 dB" in note
    assert note.endswith("004 (seed 1 18.0 dB, others from 30.0), 3 more.")


def test_markdown_marks_failures_and_reasons(mixed: Section) -> None:
    text = markdown([chapter(mixed)], [])
    assert "2/3: 1 diverged" in text
    assert "n/c: LPIPS was not computed: no VGG-16 weights on this machine" in text
    assert r"loss is nan \| &lt;b&gt;_x_&lt;/b&gt;" in text


NO_NORMALS = "the data set has no normals for its training views"
NO_WEIGHTS = "VGG-16's weights are not on this machine"


@pytest.fixture
def dropped(tmp_path: Path) -> Section:
    """EnvGS without L_mono on one of two data sets, and on it without L_perc too in one of three runs."""
    write_runs(tmp_path, (ROOM, "toy/sky_ball"), pictures=False)
    write_runs(tmp_path, (ROOM,), ("envgs", "envmap"), pictures=False, dropped_losses={"mono": NO_NORMALS})
    write_runs(
        tmp_path,
        (ROOM,),
        ("envgs",),
        seeds=(1,),
        pictures=False,
        dropped_losses={"mono": NO_NORMALS, "perceptual": NO_WEIGHTS},
    )
    write_failure(tmp_path, "toy/sky_ball", "3dgs", 2, "failed", "lost", dropped_losses={"mono": NO_NORMALS})
    return sections_of(tmp_path)[0]


@pytest.mark.parametrize(
    ("title", "sentences"),
    [
        (
            ROOM,
            [
                f"† envmap, envgs: trained without L_mono: {NO_NORMALS}.",
                f"† envgs: trained without L_perc in 1 of 3 runs: {NO_WEIGHTS}.",
            ],
        ),
        ("toy/sky_ball", []),
        (
            "toy",
            [
                f"† envmap, envgs: trained without L_mono on {ROOM}: {NO_NORMALS}.",
                f"† envgs: trained without L_perc on {ROOM} in 1 of 3 runs: {NO_WEIGHTS}.",
            ],
        ),
    ],
)
def test_a_dropped_loss_marks_its_rows_alike_in_every_format(
    dropped: Section, title: str, sentences: list[str]
) -> None:
    table = titled(dropped, title)
    assert [note for note in notes(dropped, table) if "†" in note] == sentences
    marked = {"envmap", "envgs"} if sentences else set()
    expected = [name + "†" * (name in marked) for name in METHODS]
    text = markdown([chapter(dropped)], []).split(f"### {title}\n")[1].split("\n#")[0]
    assert [line.split(" | ")[0].removeprefix("| ") for line in text.splitlines()[5 : 5 + len(METHODS)]] == expected
    assert [line for line in text.splitlines() if line.startswith("†")] == sentences
    tex = latex([chapter(dropped)]).split(f"% {title}. ")[1].split("\n%")[0]
    names = [line.split(" & ")[0] for line in tex.split("midrule\n")[1].split("\n\\bottomrule")[0].splitlines()]
    assert names == [name.replace("†", r"$^\dagger$") for name in expected]
    below = [line for line in tex.splitlines() if line.startswith(r"\par\noindent{\footnotesize $^\dagger$")]
    assert len(below) == len(sentences)
    content = structured([chapter(dropped)], [])["sections"][0]["tables"]
    rows = next(item for item in content if item["title"] == title)["rows"]
    assert [row["method"] for row in rows] == list(METHODS)
    assert {row["method"] for row in rows if row["dropped_losses"]} == marked


def test_the_json_says_which_runs_dropped_which_loss(dropped: Section) -> None:
    table = next(t for t in structured([chapter(dropped)], [])["sections"][0]["tables"] if t["title"] == "toy")
    row = next(row for row in table["rows"] if row["method"] == "envgs")
    assert row["dropped_losses"] == [
        {"loss": "mono", "why": NO_NORMALS, "dataset": ROOM, "runs": 3, "done": 3},
        {"loss": "perceptual", "why": NO_WEIGHTS, "dataset": ROOM, "runs": 1, "done": 3},
    ]


def test_every_column_says_what_it_is() -> None:
    columns = main_columns(KNOWN)
    assert len({column.key for column in columns}) == len(columns)
    assert all(column.title and column.axis for column in columns)


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs pdflatex")
def test_the_latex_compiles(mixed: Section, dropped: Section, tmp_path: Path) -> None:
    document = r"\documentclass{article}\usepackage{booktabs}\usepackage[table]{xcolor}\begin{document}\tiny" "\n"
    (tmp_path / "paper.tex").write_text(document + latex([chapter(mixed), chapter(dropped)]) + "\n" + r"\end{document}")
    run = subprocess.run(
        ["pdflatex", "-halt-on-error", "-interaction=nonstopmode", "paper.tex"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stdout[-2000:]
