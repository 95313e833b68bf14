"""Kept runs: a CSV of one row a run, and the pages whose tables are made from it."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from reports_runs import record, run_folder, write_failure, write_record, write_runs
from scipy import stats

from envgs_bench.cli.main import main
from envgs_bench.records import find_runs, read_record
from envgs_bench.reports.documentation import fill_page
from envgs_bench.reports.kept.kept_runs import TableError, column_of
from envgs_bench.reports.kept.over_scenes import mean_over_scenes
from envgs_bench.reports.kept.runs_file import FACTS, RunsFileError, read_kept

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "envgs_bench" / "docs"
RECORDS = DOCS / "records"
FILLED = [
    path
    for path in (ROOT / "README.md", *DOCS.rglob("*.md"))
    if re.search(r"<!-- (table|number): ", path.read_text(encoding="utf-8"))
]
SCENES = ("toy/chrome_room", "toy/sky_ball")


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """A folder with runs.csv, of two scenes, four methods and three seeds, one of which failed."""
    write_runs(tmp_path / "runs", SCENES, pictures=False)
    write_failure(tmp_path / "runs", "toy/sky_ball", "envgs", 3, "diverged", "loss is nan")
    assert main(["report", str(tmp_path / "runs"), "--keep", str(tmp_path / "kept" / "runs.csv")]) == 0
    return tmp_path / "kept"


def rows(kept: Path) -> list[dict[str, str]]:
    with (kept / "runs.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def filled(kept: Path, comment: str) -> str:
    page = kept / "page.md"
    page.write_text(f"# Page\n\n<!-- {comment} -->\nold\n<!-- end of table -->\n", encoding="utf-8")
    return fill_page(page, kept)[0]


def test_a_row_has_the_records_numbers_and_the_command(kept: Path) -> None:
    records = [read_record(folder) for folder in find_runs(kept.parent / "runs")]
    found = rows(kept)
    assert len(found) == len(records) == 25
    by_run = {(row["scene"], row["method"], row["seed"]): row for row in found}
    for one in records:
        row = by_run[one.dataset, one.method, str(one.seed)]
        assert row["command"] == f"envgs-bench run method={one.method} dataset={one.dataset} seed={one.seed}"
        if one.metrics is None or one.cost is None:
            assert (row["status"], row["psnr"]) == ("diverged", "")
            continue
        assert float(row["psnr"]) == pytest.approx(one.metrics.mean["psnr"], rel=1e-5)
        assert float(row["psnr_near_field"]) == pytest.approx(one.masked["near_field"].scores["psnr"], rel=1e-5)
        assert float(row["primitives"]) == sum(one.cost.primitives.values())


def test_kept_again_the_file_is_the_same_and_a_new_run_takes_the_old_ones_place(kept: Path, tmp_path: Path) -> None:
    before = (kept / "runs.csv").read_text(encoding="utf-8")
    assert main(["report", str(tmp_path / "runs"), "--keep", str(kept / "runs.csv")]) == 0
    assert (kept / "runs.csv").read_text(encoding="utf-8") == before
    write_runs(tmp_path / "newer", SCENES[:1], ("envgs",), (0,), pictures=False, steps=1500, overrides=["seed=0"])
    assert main(["report", str(tmp_path / "newer"), "--keep", str(kept / "runs.csv")]) == 0
    assert len(rows(kept)) == 25
    assert "envgs-bench run seed=0" in {row["command"] for row in rows(kept)}


def test_where_something_lay_is_no_part_of_a_command(tmp_path: Path) -> None:
    given = ["data_root=/home/me/data", "runs_dir=/scratch/runs", "method=envgs"]
    write_runs(tmp_path / "runs", SCENES[:1], ("envgs",), (0,), pictures=False, overrides=given)
    main(["report", str(tmp_path / "runs"), "--keep", str(tmp_path / "runs.csv")])
    assert rows(tmp_path)[0]["command"] == "envgs-bench run data_root=FOLDER method=envgs"


def test_a_run_that_knows_no_commit_is_given_one(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", SCENES[:1], ("envgs",), (0,), pictures=False)
    for path in (tmp_path / "runs").rglob("record.json"):
        content = json.loads(path.read_text(encoding="utf-8"))
        content["provenance"] |= {"commit": None, "dirty": None}
        path.write_text(json.dumps(content), encoding="utf-8")
    for given, found in (("", "unknown"), ("0123456789abcdef", "0123456789")):
        main(["report", str(tmp_path / "runs"), "--keep", str(tmp_path / "runs.csv"), "--commit", given])
        assert rows(tmp_path)[0]["commit"] == found


def test_scores_are_means_over_seeds_and_the_mean_is_of_the_scenes(kept: Path) -> None:
    frame = read_kept(kept / "runs.csv")
    table = filled(kept, "table: scores records=runs.csv metric=psnr")
    assert "| method | `chrome_room` | `sky_ball` | mean |" in table
    (line,) = [line for line in table.splitlines() if line.startswith("| `2dgs` |")]
    values = [frame[(frame.method == "2dgs") & (frame.scene == scene)].psnr for scene in SCENES]
    expected = [f"{each.mean():.2f} ± {each.std(ddof=1):.2f}" for each in values]
    assert [cell.strip(" *") for cell in line.split("|")[2:-1]] == [
        *expected,
        f"{np.mean([each.mean() for each in values]):.2f}",
    ]
    assert "(3/4)" in table  # of EnvGS's four on sky_ball one failed
    assert "1,500 steps, test views, protocol `envgs`, seeds 0 to 3;" in table


def test_a_metric_of_two_words_is_found_inside_regions(tmp_path: Path) -> None:
    for method, degrees in (("2dgs", 23.4), ("envgs", 2.2)):
        content = record(SCENES[0], method, 0)
        content["metrics"]["mean"]["normal_degrees"] = 40.0
        content["masked"]["near_field"]["normal_degrees"] = degrees
        write_record(run_folder(tmp_path / "runs", SCENES[0], method, 0), content)
    assert main(["report", str(tmp_path / "runs"), "--keep", str(tmp_path / "runs.csv")]) == 0
    table = filled(tmp_path, "table: scores records=runs.csv metric=normal_degrees region=near_field")
    assert "| `2dgs` | 23.4 |" in table
    assert "| `envgs` | **2.2** |" in table
    assert "near-field region" in table


def test_scenes_that_are_too_many_for_columns_are_rows(tmp_path: Path) -> None:
    scenes = [f"toy/scene_{number}" for number in range(6)]
    for number, scene in enumerate(scenes):
        for method in ("2dgs", "envgs"):
            content = record(scene, method, 0)
            content["metrics"]["mean"]["psnr"] = 20.0 + number + (method == "envgs")
            write_record(run_folder(tmp_path / "runs", scene, method, 0), content)
    assert main(["report", str(tmp_path / "runs"), "--keep", str(tmp_path / "runs.csv")]) == 0
    table = filled(tmp_path, "table: scores records=runs.csv metric=psnr").replace("*", "")
    assert "| scene | `2dgs` | `envgs` |" in table
    assert all(f"| `scene_{number}` | {20 + number}.00 | {21 + number}.00 |" in table for number in range(6))
    assert "| mean | 22.50 | 23.50 |" in table


def test_longer_runs_stand_beside_those_of_the_same_seed(kept: Path, tmp_path: Path) -> None:
    """Seed 1 of one scene was run for longer: of the shorter runs, means of three seeds, that seed alone is shown."""
    longer = {"envgs": 31.5, "2dgs": 20.25}
    for method, psnr in longer.items():
        content = record(SCENES[0], method, 1, steps=9000)
        content["metrics"]["mean"]["psnr"] = psnr
        write_record(run_folder(tmp_path / "longer", SCENES[0], method, 1), content)
    assert main(["report", str(tmp_path / "longer"), "--keep", str(kept / "runs.csv")]) == 0
    table = filled(kept, "table: lengths records=runs.csv steps=1500,9000")
    frame = read_kept(kept / "runs.csv")
    shorter = frame[(frame.scene == SCENES[0]) & (frame.seed == 1) & (frame.steps == 1500)].set_index("method").psnr
    cells = [f"{shorter[method]:.2f} → {longer[method]:.2f}" for method in ("2dgs", "envgs")]
    lines = [line for line in table.replace("*", "").splitlines() if line.startswith("| ")]
    assert lines == ["| scene | `2dgs` | `envgs` |", "| :-- | --: | --: |", f"| `chrome_room` | {' | '.join(cells)} |"]
    assert "→ **31.50** |" in table
    assert "1,500 and 9,000 steps. Test views, protocol `envgs`, seed 1;" in table
    alone = filled(kept, "table: lengths records=runs.csv method=envgs steps=1500,9000").replace("*", "")
    assert f"| scene | `envgs` |\n| :-- | --: |\n| `chrome_room` | {cells[1]} |\n" in alone
    assert "Not measured: " in filled(kept, "table: lengths records=runs.csv steps=1500,12000")


def test_gains_are_paired_and_have_students_interval(kept: Path) -> None:
    frame = read_kept(kept / "runs.csv")
    table = filled(kept, "table: gains of=envgs records=runs.csv scene=toy/chrome_room")
    pairs = [
        frame[(frame.method == name) & (frame.scene == SCENES[0])].sort_values("seed").psnr.to_numpy()
        for name in ("envgs", "2dgs")
    ]
    low, high = stats.ttest_rel(*pairs).confidence_interval()
    assert f"**+{(pairs[0] - pairs[1]).mean():.2f}** [+{low:.2f}, +{high:.2f}]" in table


def test_costs_are_of_one_device(kept: Path) -> None:
    assert "| primitives | environment primitives | train s | frame ms |" in filled(
        kept, "table: costs records=runs.csv"
    )
    text = (kept / "runs.csv").read_text(encoding="utf-8")
    device = rows(kept)[0]["device"]
    (kept / "runs.csv").write_text(text.replace(device, "another device", 1), encoding="utf-8")
    with pytest.raises(TableError, match="several device"):
        filled(kept, "table: costs records=runs.csv")


def test_a_run_on_a_processor_replaces_none_on_a_gpu(tmp_path: Path) -> None:
    """And one on another GPU replaces it: a seed counts once a kind of device."""

    def keep(kind: str, name: str) -> list[str]:
        for path in (tmp_path / "runs").rglob("record.json"):
            content = json.loads(path.read_text(encoding="utf-8"))
            content["provenance"] |= {"device": {"type": kind, "name": name}, "threads": 4}
            path.write_text(json.dumps(content), encoding="utf-8")
        assert main(["report", str(tmp_path / "runs"), "--keep", str(tmp_path / "runs.csv")]) == 0
        return sorted(row["device"] for row in rows(tmp_path))

    write_runs(tmp_path / "runs", SCENES[:1], ("3dgs",), (0,), pictures=False)
    assert keep("cpu", "A processor") == ["A processor, 4 threads"]
    assert keep("cuda", "A GPU") == ["A GPU", "A processor, 4 threads"]
    assert keep("cuda", "Another GPU") == ["A processor, 4 threads", "Another GPU"]
    assert keep("cpu", "Another processor") == ["Another GPU", "Another processor, 4 threads"]


def test_programs_stand_beside_ours_on_one_scene_whatever_they_ran_on(tmp_path: Path) -> None:
    """Where a program lies is no part of its name; what it was told is."""
    scene, told = SCENES[:1], {"commands": {}, "page": "p", "commit": "c", "licence": "l", "tried": ""}
    write_runs(tmp_path / "runs", scene, ("3dgs",), (0,), pictures=False)
    at = ["method=external", "method.recipe=other", "method.settings.home=/home/me/other"]
    for name, more in (("other", []), ("elsewhere", ["method.settings.arguments=--fast"])):
        write_runs(tmp_path / "runs", scene, (name,), (0,), pictures=False, overrides=[*at, *more], kind="external")
    for path in (tmp_path / "runs").rglob("record.json"):
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["kind"] == "external":
            content["program"] = {**told, "own_seconds": 12.3, "agreement_db": 49.56}
            content["provenance"]["device"] = {"type": "cuda", "name": "Another GPU"}
            path.write_text(json.dumps(content), encoding="utf-8")
    assert main(["report", str(tmp_path / "runs"), "--keep", str(tmp_path / "runs.csv")]) == 0
    by_method = {row["method"]: row for row in rows(tmp_path)}
    assert set(by_method) == {"3dgs", "other", "elsewhere [arguments=--fast]"}
    assert by_method["other"]["command"] == "envgs-bench run method=external method.recipe=other"
    lines = filled(tmp_path, f"table: programs records=runs.csv scene={scene[0]}").splitlines()
    (head,) = (line for line in lines if line.startswith("| method |"))
    (row,) = (line for line in lines if line.startswith("| `other` |"))
    cells = dict(zip(*([cell.strip() for cell in line.strip("|").split("|")] for line in (head, row)), strict=True))
    assert (cells["on"], cells["own train s"], cells["agreement dB"]) == ("Another GPU", "12", "49.6")
    assert any(line.startswith("| `3dgs` |") for line in lines)
    kept = (tmp_path / "runs.csv").read_text(encoding="utf-8").splitlines()
    (ours,) = (line for line in kept if ",3dgs," in line)
    with (tmp_path / "runs.csv").open("a", encoding="utf-8") as file:
        file.write(ours.replace("made-up CPU", "another CPU") + "\n")
    lines = filled(tmp_path, f"table: programs records=runs.csv scene={scene[0]}").splitlines()
    on = [line.split("|")[2].strip() for line in lines if line.startswith("| `3dgs` |")]
    assert on == ["another CPU, 2 threads", "made-up CPU, 2 threads"]
    with pytest.raises(TableError, match="seed 0 of 3dgs on toy/chrome_room twice, of several devices"):
        filled(tmp_path, "table: scores records=runs.csv method=3dgs")
    write_runs(tmp_path / "runs", SCENES[1:], ("3dgs",), (0,), pictures=False)
    main(["report", str(tmp_path / "runs"), "--keep", str(tmp_path / "runs.csv")])
    with pytest.raises(TableError, match="several scene"):
        filled(tmp_path, "table: programs records=runs.csv")


@pytest.mark.parametrize(
    ("comment", "message"),
    [
        ("table: scores metric=psnr", "say records=<file>"),
        ("table: scores records=runs.csv metric=psrn", "no metric 'psrn', but psnr"),
        ("table: sums records=runs.csv", "no table 'sums', but scores, gains, costs, over_scenes"),
        ("table: gains records=runs.csv of=envgz", "no method 'envgz' here, but"),
        ("table: scores records=runs.csv colour=red", "cannot be asked so"),
        ("table: scores records=runs.csv region=glass", "no psnr of region=glass here, but of full, near_field, refl"),
        ("table: scores records=runs.csv metric=normal_degrees", "no normal_degrees here, but psnr, ssim"),
        ("table: gains records=runs.csv of=envgs region=glass", "no psnr of region=glass here"),
        ("table: over_scenes records=runs.csv of=envgs region=glass", "no psnr of region=glass here"),
        ("table: lengths records=runs.csv steps=1500 region=glass", "no psnr of region=glass here"),
        ("table: gains records=runs.csv of=envgs method=envgs", "no run that is chosen has a number"),
    ],
)
def test_what_cannot_be_filled_is_said(kept: Path, comment: str, message: str) -> None:
    with pytest.raises(TableError, match=message):
        filled(kept, comment)


@pytest.mark.parametrize(
    ("comment", "message"),
    [
        ("less=2dgs records=runs.csv region=glass", "no psnr of region=glass here, but of full, near_field, refl"),
        ("less=failed records=runs.csv", "no scene has psnr of region=full of both 'envgs' and 'failed'"),
        ("less=failed records=runs.csv over=scenes", "no scene has psnr of region=full of both 'envgs' and 'failed'"),
    ],
)
def test_a_number_that_no_runs_have_is_said(kept: Path, comment: str, message: str) -> None:
    write_failure(kept.parent / "runs", SCENES[0], "failed", 0, "diverged", "loss is nan")
    assert main(["report", str(kept.parent / "runs"), "--keep", str(kept / "runs.csv")]) == 0
    page = kept / "page.md"
    page.write_text(f"By <!-- number: of=envgs {comment} -->+9.00<!-- end --> dB.", encoding="utf-8")
    with pytest.raises(TableError, match=message):
        fill_page(page, kept)


def test_what_no_run_was_kept_of_stands_as_not_measured(kept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = kept / "page.md"
    page.write_text(
        "<!-- table: scores records=runs.csv steps=7 -->\n<!-- end of table -->\n"
        "By <!-- number: of=envgs less=2dgs records=other.csv -->+9.00<!-- end --> dB.",
        encoding="utf-8",
    )
    assert main(["report", str(kept), "--fill", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    assert "*Not measured: kept/runs.csv has no run with steps=7.*" in text
    assert "-->(not measured)<!-- end --> dB." in text
    told = capsys.readouterr().err
    assert told.count("not measured") == 2
    assert "there is no kept/other.csv" in told


def test_few_scenes_have_students_interval() -> None:
    gained = np.array([-0.37, 0.64, 0.09, -0.08, -0.61])
    low, high = stats.t.interval(0.95, 4, gained.mean(), stats.sem(gained))
    expected = f"{gained.mean():+.2f} [{low:+.2f}, {high:+.2f}]".replace("-", "−")
    assert mean_over_scenes(gained, column_of("psnr")) == expected


def test_over_many_scenes_each_counts_once(tmp_path: Path) -> None:
    scenes = tuple(f"sampled/{index}" for index in range(12))
    write_runs(tmp_path / "runs", scenes, ("2dgs", "envgs"), (0, 1), pictures=False)
    write_failure(tmp_path / "runs", scenes[0], "2dgs", 2, "diverged", "loss is nan")
    main(["report", str(tmp_path / "runs"), "--keep", str(tmp_path / "kept" / "runs.csv")])
    frame = read_kept(tmp_path / "kept" / "runs.csv")
    means = frame[frame.status == "ok"].groupby(["scene", "method"]).psnr.mean().unstack()
    gained = means["envgs"] - means["2dgs"]
    table = filled(tmp_path / "kept", "table: over_scenes records=runs.csv of=envgs")
    (line,) = [line for line in table.splitlines() if line.startswith("| `2dgs` |")]
    _, scenes_of, mean, ahead, level, worst, failed = (cell.strip() for cell in line.split("|")[1:-1])
    assert (scenes_of, failed) == ("12", "1")
    signed = f"{gained.mean():+.2f}".replace("-", "−")
    page = tmp_path / "kept" / "page.md"
    page.write_text("<!-- number: of=envgs less=2dgs records=runs.csv over=scenes -->?<!-- end -->", encoding="utf-8")
    assert f"-->{mean}<!-- end -->" in fill_page(page, tmp_path / "kept")[0]
    page.write_text(
        "<!-- number: of=envgs less=2dgs records=runs.csv over=scenes metric=ssim -->?<!-- end -->", encoding="utf-8"
    )
    of_ssim = frame[frame.status == "ok"].groupby(["scene", "method"]).ssim.mean().unstack()
    expected = f"{(of_ssim['envgs'] - of_ssim['2dgs']).mean():+.3f}".replace("-", "−")
    assert f"-->{expected} [" in fill_page(page, tmp_path / "kept")[0]
    low, high = stats.bootstrap((gained,), np.mean, method="percentile", rng=0).confidence_interval
    ends = re.fullmatch(re.escape(signed) + r" \[([+−][\d.]+), ([+−][\d.]+)\]", mean)
    assert ends is not None
    found = [float(end.replace("−", "-")) for end in ends.groups()]
    assert found == pytest.approx([low, high], abs=0.02)
    for cell, hits in ((ahead, int((gained > 0).sum())), (level, int((gained > -0.1).sum()))):
        ends = stats.binomtest(hits, 12).proportion_ci(method="exact")
        assert cell == f"{100 * hits / 12:.0f} % [{100 * ends.low:.0f}, {100 * ends.high:.0f}]"
    assert "Failed runs of `envgs`: 0" in table
    assert worst == f"{gained.min():+.2f}".replace("-", "−")


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "other.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    with pytest.raises(RunsFileError, match="it has no scene"):
        read_kept(tmp_path / "other.csv")


def test_a_number_in_a_sentence_is_filled(kept: Path) -> None:
    page = kept / "page.md"
    page.write_text("By <!-- number: of=envgs less=2dgs records=runs.csv -->?<!-- end --> dB.", encoding="utf-8")
    assert re.search(r"--> ?\+\d\.\d\d \[\+\d\.\d\d, \+\d\.\d\d\]<!-- end --> dB\.", fill_page(page, kept)[0])


@pytest.mark.parametrize("page", FILLED, ids=lambda path: path.stem)
def test_the_pages_are_in_step_with_their_records(page: Path) -> None:
    """Where this fails: envgs-bench report envgs_bench/docs/records --fill <page>"""
    assert fill_page(page, RECORDS)[0] == page.read_text(encoding="utf-8")


def test_records_are_small_and_of_committed_code() -> None:
    files = list(RECORDS.glob("*.csv"))
    assert sum(path.stat().st_size for path in files) < 1_000_000
    for path in files:
        with path.open(encoding="utf-8", newline="") as stream:
            found = list(csv.DictReader(stream))
        if set(FACTS) <= set(found[0]):
            assert {row["commit"] for row in found if not re.fullmatch(r"[0-9a-f]{7,10}", row["commit"])} == set(), path
