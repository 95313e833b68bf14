"""Differences to the best: who is best, by how much over every other method, paired by seed, with their interval."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from reports_runs import chapter, record, run_folder, write_failure, write_record, write_runs
from scipy import stats

from envgs_bench.reports import build_report
from envgs_bench.reports.numbers.estimates import Numbers
from envgs_bench.reports.numbers.runs import read_runs
from envgs_bench.reports.studies.differences.differences import Differences, differences
from envgs_bench.reports.studies.differences.study import DifferencesToBest
from envgs_bench.reports.tables.latex import latex
from envgs_bench.reports.tables.sections import split_sections
from envgs_bench.reports.tables.table import Table

PSNR = {  # by data set and method, over seeds 0, 1 and 2
    ("room", "a"): (20.0, 20.5, 20.3),
    ("room", "b"): (19.0, 19.9, 19.1),
    ("ball", "a"): (25.0, 25.2, 25.1),
    ("ball", "b"): (25.5, 25.6, 26.3),
    ("table", "a"): (30.0, 30.1, 30.4),
    ("table", "b"): (29.0, 29.0, 29.0),
}


def differences_of(
    values: dict[tuple[str, str], tuple[float, ...]], failed: tuple[str, str, int] | None = None
) -> Differences | None:
    runs = [(d, m, seed, value) for (d, m), found in values.items() for seed, value in enumerate(found)]
    tidy = pd.DataFrame(
        [(d, m, seed, "full", "psnr", value) for d, m, seed, value in runs if (d, m, seed) != failed],
        columns=["dataset", "method", "seed", "region", "metric", "value"],
    )
    attempts = pd.DataFrame(
        [(d, m, seed, "diverged" if (d, m, seed) == failed else "ok") for d, m, seed, _ in runs],
        columns=["dataset", "method", "seed", "status"],
    )
    datasets, methods = (sorted({key[i] for key in values}) for i in (0, 1))
    return differences(Numbers(tidy, attempts), datasets, methods)


def test_the_best_method_is_that_on_most_data_sets_and_its_differences_are_paired_with_students_interval() -> None:
    found = differences_of(PSNR)
    assert found is not None
    assert (found.best, found.others, found.datasets) == ("a", ("b",), ("ball", "room", "table"))
    for dataset in found.datasets:
        values = np.subtract(PSNR[dataset, "a"], PSNR[dataset, "b"])
        expected = stats.ttest_1samp(values, 0).confidence_interval(0.95)
        difference = found.to("b", (dataset,), "full", "psnr").difference
        assert float(difference.mean or 0) == pytest.approx(values.mean())
        assert difference.interval == pytest.approx((expected.low, expected.high))
        assert difference.interval is not None
        assert difference.interval.low < values.min()  # which no bootstrap's is
    mean = found.to("b", found.datasets, "full", "psnr").difference.mean
    assert float(mean or 0) == pytest.approx(np.mean([np.subtract(PSNR[d, "a"], PSNR[d, "b"]) for d in found.datasets]))


def test_methods_that_are_best_equally_often_are_told_apart_by_their_means() -> None:
    tied = {key: value for key, value in PSNR.items() if key[0] != "table"}
    found = differences_of(tied)
    assert found is not None
    assert found.best == "a"  # 22.7 dB over both, b 22.6
    found = differences_of(tied | {("ball", "b"): (26.5, 26.6, 26.3)})
    assert found is not None
    assert found.best == "b"


def test_who_did_not_finish_somewhere_is_best_nowhere_there_and_who_stands_alone_is_compared_with_nobody() -> None:
    found = differences_of(PSNR, failed=("table", "a", 1))
    assert found is not None
    assert (found.best, found.datasets) == ("b", ("ball", "room", "table"))
    pair = found.to("a", ("table",), "full", "psnr").difference
    assert (pair.done, pair.expected) == (2, 3)
    alone = differences_of(PSNR | {("garden", "b"): (29.0, 29.0, 29.0), ("street", "b"): (29.0, 29.0, 29.0)})
    assert alone is not None
    assert (alone.best, alone.datasets) == ("a", ("ball", "room", "table"))
    assert differences_of({key: value[:1] for key, value in PSNR.items()}) is None  # one seed: no interval
    assert differences_of({key: value for key, value in PSNR.items() if key[1] == "a"}) is None  # nobody else


def tables_of(runs: Path) -> list[Table]:
    (section,) = split_sections(read_runs(runs)[0])
    study = DifferencesToBest.of(section)
    return list(study.tables()) if study is not None else []


def test_there_is_a_table_for_the_whole_picture_and_for_each_region(tmp_path: Path) -> None:
    datasets = ("toy/chrome_room", "toy/diffuse_room", "toy/sky_ball")
    write_runs(tmp_path, datasets, pictures=False)
    tables = tables_of(tmp_path)
    assert [table.title.partition(": ")[2] for table in tables] == ["PSNR", "PSNR near-field", "PSNR reflective"]
    assert {table.title.partition(" ")[0] for table in tables} == {"envgs"}  # by the made-up numbers
    whole, near, _ = tables
    assert [row.method for row in whole.rows] == ["3dgs", "2dgs", "envmap"]
    assert [column.group for column in whole.columns] == ["mean of 3", *datasets]
    assert [column.group for column in near.columns] == ["mean of 2", "toy/chrome_room", "toy/sky_ball"]
    assert {row.runs_text for row in near.rows} == {"6/6"}
    psnr = {
        m: [record("toy/sky_ball", m, seed)["metrics"]["mean"]["psnr"] for seed in range(3)] for m in ("envgs", "2dgs")
    }
    values = np.subtract(psnr["envgs"], psnr["2dgs"])
    (cell,) = [cell for key, cell in whole.rows[1].cells.items() if key.startswith("toy/sky_ball")]
    assert cell.text.startswith(f"{values.mean():+.2f} [")
    ends = stats.ttest_1samp(values, 0).confidence_interval(0.95)
    assert cell.text.endswith(f"[{ends.low:+.2f}, {ends.high:+.2f}]")


def test_a_mean_stands_where_all_of_its_data_sets_have_the_pairs(tmp_path: Path) -> None:
    write_runs(tmp_path, ("toy/chrome_room", "toy/sky_ball"), ("envgs", "2dgs"), pictures=False)
    write_runs(tmp_path, ("toy/sky_ball",), ("3dgs",), pictures=False)
    whole = tables_of(tmp_path)[0]
    cells = {row.method: [cell.text for cell in row.cells.values()] for row in whole.rows}
    assert cells["3dgs"][:2] == ["— (1/2)", "—"]
    assert cells["3dgs"][2].startswith("+")
    assert cells["2dgs"][0].startswith("+")


def test_failed_runs_are_counted_and_validation_views_have_no_such_part(tmp_path: Path) -> None:
    write_runs(tmp_path / "test", methods=("envgs", "2dgs"), pictures=False)
    write_failure(tmp_path / "test", "toy/chrome_room", "2dgs", 3, "diverged", "the loss is not finite")
    whole = tables_of(tmp_path / "test")[0]
    assert whole.rows[0].runs_text == "3/4: 1 diverged"
    write_runs(tmp_path / "validation", methods=("envgs", "2dgs"), pictures=False, scored_on="validation")
    assert tables_of(tmp_path / "validation") == []


def test_every_format_has_the_part_with_its_intervals_and_says_how_to_read_it(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", ("toy/chrome_room", "toy/sky_ball"), pictures=False)
    for seed in range(3):  # somebody's words stay words
        hostile = record("toy/sky_ball", "<b>|evil", seed)
        write_record(run_folder(tmp_path / "runs", "toy/sky_ball", "evil", seed), hostile)
    out = tmp_path / "out"
    report = build_report(tmp_path / "runs", out)
    page, markdown = report.page.read_text(), (out / "table.md").read_text()
    (section,) = json.loads((out / "table.json").read_text())["sections"]
    whole = next(table for table in section["tables"] if table["kind"] == DifferencesToBest.name)
    (row,) = [row for row in whole["rows"] if row["method"] == "2dgs"]
    cell = next(iter(row["cells"].values()))
    low, high = cell["interval"]
    assert low < cell["mean"] < high
    for text in (markdown, page):
        assert f"{cell['mean']:+.2f}" in text
        assert "which holds 0 where seeds do not show who is" in text
        assert "<b>|evil" not in text
    assert "### envgs less the others: PSNR\n" in markdown
    assert ">Differences to the best<" in page
    assert "envgs less the others" in latex(list(map(chapter, report.sections)))
