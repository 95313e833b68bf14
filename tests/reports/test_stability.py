"""Perturbed runs: paired with their partners, judged by their gates, told in sentences, and in no ordinary table."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from reports_runs import record, row_of, sections_of, tables_of, write_record, write_runs
from scipy.stats import mannwhitneyu

from envgs_bench.fixed_rays import FixedRaySamples, write_samples
from envgs_bench.reports import build_report
from envgs_bench.reports.charts.drawn import Canvas
from envgs_bench.reports.numbers.intervals import mean_interval
from envgs_bench.reports.studies.stability.breaking_points import breaking_point, breaking_points
from envgs_bench.reports.studies.stability.corruption_error import mean_corruption_error
from envgs_bench.reports.studies.stability.csv_tables import cells_table
from envgs_bench.reports.studies.stability.expectations import expectations
from envgs_bench.reports.studies.stability.perturbed_runs import PerturbedRun
from envgs_bench.reports.studies.stability.profiles import drops, probability_of_improvement, profile
from envgs_bench.reports.studies.stability.stability import Stability
from envgs_bench.reports.studies.stability.study import StabilityStudy
from envgs_bench.reports.studies.stability.table import stability_tables

ROOM = "toy/chrome_room"
BLUR = (ROOM, "blur")
GATES = {
    "psnr_drop_db": 3.0,
    "region_drop_db": 3.0,
    "count_factor": 2.0,
    "memory_factor": 2.0,
    "time_factor": 3.0,
    "baseline": "2dgs",
    "behind_db": 0.1,
}


def write(
    folder: Path,
    method: str,
    seed: int,
    severity: int,
    psnr: float | None,
    kind: str = "blur",
    steps: int = 100,
    **changes: Any,
) -> None:
    """A run of this PSNR, which did not finish where that is None; severity 0 is unperturbed."""
    content = record(ROOM, method, seed)
    content["config"] |= {"gates": GATES, "steps": steps}
    content["steps"] = steps
    if severity:
        content["perturbation"] = {"kind": kind, "severity": severity, "level": f"{severity} pixels"}
    if psnr is None:
        content |= {"status": "diverged", "error": {"type": "Diverged", "message": "lost", "log_tail": ""}}
        content |= {"metrics": None, "masked": {}, "timing": None, "cost": None}
    else:
        content["metrics"]["mean"]["psnr"] = psnr
        content["metrics"]["per_view"] = [{"view": f"{i:03d}", "psnr": psnr + i - 2} for i in range(5)]
        content["masked"] = {"reflective": {"psnr": psnr - 2, "fraction": 0.2, "per_view": []}}
        content["cost"] |= {"peak_primitives": 1000, "train_seconds": 10.0}
    for key, value in changes.items():
        part, _, name = key.partition("__")
        if name:
            content[part][name] = value
        else:
            content[part] = value
    write_record(folder / f"{method}-{kind}-{severity}-{seed}-{steps}", content)


def stability_of(folder: Path) -> Stability:
    (section,) = sections_of(folder)
    return Stability(section.with_perturbed)


def write_study(folder: Path, seeds: int = 5) -> None:
    """2DGS falls by 1 dB a severity; EnvGS starts 3 dB above it and falls by 2.5: 1.5 above, 0 above, 1.5 below."""
    for seed in range(seeds):
        for severity in range(4):
            wobble = 0.01 * (seed - 2)
            write(folder, "2dgs", seed, severity, 25.0 - severity + wobble)
            write(folder, "envgs", seed, severity, 28.0 - 2.5 * severity + 2 * wobble)


def test_a_perturbed_run_is_compared_with_the_run_of_its_own_seed(tmp_path: Path) -> None:
    for seed, (before, after) in enumerate([(30.0, 29.0), (20.0, 17.5), (25.0, 24.5)]):
        write(tmp_path, "envgs", seed, 0, before)
        write(tmp_path, "envgs", seed, 1, after)
    change = stability_of(tmp_path).cell(BLUR, 1, "envgs").change("psnr")
    assert change.strata == ((-1.0, -2.5, -0.5),)
    assert change.interval == mean_interval([[-1.0, -2.5, -0.5]])
    values = stability_of(tmp_path).cell(BLUR, 1, "envgs")
    assert values.values("psnr_median_view").strata == ((29.0, 17.5, 24.5),)
    assert values.values("psnr_worst_view").strata == ((27.0, 15.5, 22.5),)
    assert values.values("psnr_p5_view").strata[0][0] == pytest.approx(np.percentile([27, 28, 29, 30, 31], 5))


def test_both_are_printed_where_views_were_aligned(tmp_path: Path) -> None:
    write(tmp_path, "envgs", 0, 0, 25.0)
    write(tmp_path, "envgs", 0, 1, 20.0, kind="pose_rotation", metrics__mean={"psnr": 20.0, "psnr_aligned": 24.0})
    (table,) = stability_tables(stability_of(tmp_path))
    perturbed = row_of(table, "envgs, severity 1")
    assert (perturbed.cells["psnr"].mean, perturbed.cells["psnr_aligned"].mean) == (20.0, 24.0)
    assert row_of(table, "envgs, unperturbed").cells["psnr_aligned"].mean is None
    assert "PSNR aligned" in {column.title for column in table.columns}


def test_the_partner_has_the_same_settings_and_steps(tmp_path: Path) -> None:
    write(tmp_path, "envgs", 0, 0, 30.0, steps=100)
    write(tmp_path, "envgs", 0, 0, 20.0, steps=900)
    write(tmp_path, "envgs", 0, 1, 29.0, steps=100)
    write(tmp_path, "envgs", 0, 2, 28.0, steps=100, perturbation={"kind": "steps_fewer", "severity": 2, "level": "÷ 2"})
    fewer = json.loads((tmp_path / "envgs-blur-2-0-100/record.json").read_text()) | {"steps": 50}  # as they were done
    write_record(tmp_path / "envgs-blur-2-0-100", fewer)
    stability = stability_of(tmp_path)
    assert stability.methods == ["envgs [steps=100]"]
    assert stability.cell(BLUR, 1, "envgs [steps=100]").change("psnr").strata == ((-1.0,),)
    assert stability.cell((ROOM, "steps_fewer"), 2, "envgs [steps=100]").change("psnr").strata == ((-2.0,),)


def test_of_two_equal_perturbed_runs_the_newest_counts(tmp_path: Path) -> None:
    write(tmp_path, "envgs", 0, 0, 30.0)
    write(tmp_path / "old", "envgs", 0, 1, 10.0, provenance__finished="2026-01-01T09:00:00+00:00")
    write(tmp_path / "new", "envgs", 0, 1, 29.0, provenance__finished="2026-01-01T11:00:00+00:00")
    assert stability_of(tmp_path).cell(BLUR, 1, "envgs").values("psnr").strata == ((29.0,),)


@pytest.mark.parametrize(
    ("changes", "outcome"),
    [
        ({"psnr": 27.0}, "survived"),
        ({"psnr": 26.9}, "collapsed"),
        ({"psnr": 28.0, "masked__reflective": {"psnr": 24.9, "fraction": 0.2, "per_view": []}}, "collapsed"),
        ({"psnr": 30.0, "cost__peak_primitives": 2000}, "survived"),
        ({"psnr": 30.0, "cost__peak_primitives": 2001}, "exploded"),
        ({"psnr": 30.0, "cost__peak_host_bytes": 1_800_000_001}, "exploded"),
        ({"psnr": 30.0, "cost__train_seconds": 30.1}, "slow"),
        ({"psnr": None}, "diverged"),
        ({"psnr": None, "status": "out_of_memory"}, "out_of_memory"),
        ({"psnr": None, "status": "timeout"}, "timeout"),
        ({"psnr": None, "status": "failed"}, "failed"),
        ({"psnr": None, "status": "interrupted"}, "interrupted"),
        (
            {"psnr": None, "status": "failed", "error": {"type": "DatasetError", "message": "x", "log_tail": ""}},
            "impossible",
        ),
    ],
)
def test_a_run_is_judged_by_its_status_and_by_the_gates_against_its_partner(
    tmp_path: Path, changes: dict[str, Any], outcome: str
) -> None:
    write(tmp_path, "envgs", 0, 0, 30.0)
    write(tmp_path, "envgs", 0, 1, **changes)
    assert the_run(tmp_path).outcome == outcome


def the_run(folder: Path) -> PerturbedRun:
    (run,) = stability_of(folder).cell(BLUR, 1, "envgs").runs
    return run


def test_gates_are_those_that_the_run_carries(tmp_path: Path) -> None:
    write(tmp_path, "envgs", 0, 0, 30.0)
    config = record(ROOM, "envgs", 0)["config"] | {"steps": 100}
    write(tmp_path, "envgs", 0, 1, 20.0, config=config | {"gates": GATES | {"psnr_drop_db": 11, "region_drop_db": 11}})
    assert the_run(tmp_path).outcome == "survived"
    write(tmp_path, "envgs", 0, 1, 20.0, config=config | {"gates": {"psnr_drop_db": "much"}})
    assert the_run(tmp_path).gates is None
    assert the_run(tmp_path).outcome == "survived"
    (table,) = (table for table in tables_of(sections_of(tmp_path)[0]) if table.kind == "stability")
    assert any("no gates that can be read" in remark for remark in table.remarks)


def test_a_case_without_a_finished_partner_says_so(tmp_path: Path) -> None:
    write(tmp_path, "envgs", 0, 0, None)
    write(tmp_path, "envgs", 0, 1, 5.0)
    write(tmp_path, "envgs", 1, 1, 5.0)
    cell = stability_of(tmp_path).cell(BLUR, 1, "envgs")
    assert (cell.outcomes["survived"], cell.failures, cell.unpaired) == (2, 0, 2)
    assert cell.change("psnr").mean is None
    html = build_report(tmp_path, tmp_path / "out").page.read_text()
    assert "envgs, severity 1: 2 of 2 runs have no finished partner" in html
    assert "2 without a finished partner" in html


def test_failures_that_nothing_tells_are_silent(tmp_path: Path) -> None:
    warning = {"kind": "learns_nothing", "step": 50, "part": "", "message": "worse than one color"}
    for seed in range(3):
        write(tmp_path, "envgs", seed, 0, 30.0)
        write(tmp_path, "envgs", seed, 1, 20.0 if seed else None, warnings=[warning] if seed == 1 else [])
    cell = stability_of(tmp_path).cell(BLUR, 1, "envgs")
    assert (cell.failures, cell.silent) == (3, 1)
    assert cell.warnings == {"learns_nothing": 1}


def test_a_loss_that_the_partner_has_and_the_run_dropped_is_no_silence(tmp_path: Path) -> None:
    everywhere = {"perceptual": "no weights"}
    for seed, dropped in enumerate([everywhere | {"mono": "no normals"}, everywhere]):
        write(tmp_path, "envgs", seed, 0, 30.0, dropped_losses=everywhere)
        write(tmp_path, "envgs", seed, 1, 20.0, dropped_losses=dropped)
    cell = stability_of(tmp_path).cell(BLUR, 1, "envgs")
    assert (cell.failures, cell.silent) == (2, 1)


def test_the_share_of_failures_is_not_certain_after_five_runs(tmp_path: Path) -> None:
    for seed in range(5):
        write(tmp_path, "envgs", seed, 0, 30.0)
        write(tmp_path, "envgs", seed, 1, None)
    interval = stability_of(tmp_path).cell(BLUR, 1, "envgs").failure_interval
    assert interval is not None
    z2 = 1.959964**2
    assert interval == pytest.approx((5 / (5 + z2), 1), rel=1e-6)  # Wilson's, where all failed


def test_runs_further_behind_the_baseline_than_allowed_are_counted(tmp_path: Path) -> None:
    for seed, psnr in enumerate([25.0, 24.91, 24.89, None]):
        write(tmp_path, "2dgs", seed, 1, 25.0)
        write(tmp_path, "envgs", seed, 1, psnr)
    assert stability_of(tmp_path).cell(BLUR, 1, "envgs").behind == (2, 4)
    assert stability_of(tmp_path).cell(BLUR, 1, "2dgs").behind == (0, 0)


def test_the_gain_breaks_where_a_hand_finds_it(tmp_path: Path) -> None:
    write_study(tmp_path)
    half, none = breaking_points(stability_of(tmp_path), BLUR, "envgs")
    assert half.severity == pytest.approx(1.0)  # 3 dB at 0, 1.5 at 1
    assert none.severity == pytest.approx(2.0)
    assert half.interval is not None
    assert half.interval.low < 1.0 < half.interval.high
    assert breaking_points(stability_of(tmp_path), BLUR, "2dgs") == []


@pytest.mark.parametrize(
    ("gains", "half", "none"),
    [
        ([[4, 3, 1, -1]], 1.5, 2.5),
        ([[4, 3, -math.inf, -math.inf]], 2.0, 2.0),  # a failure has lost it there, and not before
        ([[4, 4, 3, 2.5]], math.inf, math.inf),
        ([[4, math.nan, 0, -1]], 1.0, 2.0),  # from 4 at 0 to 0 at 2
        ([[4, 3, 1, 0], [2, 1, -1, -2]], 1.25, 2.0),  # means 3, 2, 0, -1; 1.5 is left a quarter of the way from 1 to 2
        ([[4, 4, 4, 4], [4, 4, 4, -math.inf], [4, 4, 4, -math.inf]], 3.0, 3.0),  # most failed
        ([[4, 4, 4, 4], [4, 4, 4, 4], [4, 4, 4, -math.inf]], math.inf, math.inf),
    ],
)
def test_breaking_points_are_interpolated(gains: list[list[float]], half: float, none: float) -> None:
    found = [breaking_point([0, 1, 2, 3], np.array(gains), share) for share in (0.5, 0.0)]
    assert [point.severity for point in found] == pytest.approx([half, none])
    assert all((point.interval is None) == (len(gains) == 1) for point in found)


def test_a_breaking_points_interval_is_seeded_and_holds_the_seeds_own() -> None:
    rng = np.random.default_rng(7)
    gains = np.array([3.0, 1.5, 0.5, -0.5]) + rng.normal(0, 0.2, (6, 4))
    first, again = (breaking_point([0, 1, 2, 3], gains, 0.5) for _ in range(2))
    assert first == again
    other = breaking_point([0, 1, 2, 3], gains, 0.5, seed=1)
    assert other.severity == first.severity
    assert first.interval is not None
    assert other.interval is not None
    assert first.interval != other.interval
    assert first.interval == pytest.approx(other.interval, abs=0.1)
    assert first.interval.low < first.severity < first.interval.high


def test_the_probability_of_improvement_is_the_u_statistic() -> None:
    rng = np.random.default_rng(0)
    tasks = [(rng.normal(0.3, 1, 5), rng.normal(0, 1, 6)) for _ in range(8)]
    expected = np.mean([mannwhitneyu(x, y).statistic / (len(x) * len(y)) for x, y in tasks])
    share, interval = probability_of_improvement(tasks)
    assert share == pytest.approx(expected)
    assert interval is not None
    assert interval.low < share < interval.high
    assert probability_of_improvement(tasks) == (share, interval)
    assert probability_of_improvement([([1.0, -math.inf], [-math.inf, 0.0])])[0] == 0.625  # 1 + 1 + ½ + 0 of 4
    assert probability_of_improvement([([1.0], [0.0])]) == (1.0, None)


def test_the_mean_corruption_error_is_the_mean_of_ratios_of_summed_errors(tmp_path: Path) -> None:
    """Two kinds: EnvGS has twice the baseline's error in one, and in the other a run that failed beside half of it."""
    for severity in (1, 2):
        write(tmp_path, "2dgs", 0, severity, 20.0)  # RMSE 0.1
        write(tmp_path, "envgs", 0, severity, 20.0 - 20 * math.log10(2))
        write(tmp_path, "2dgs", 0, severity, 20.0, kind="noise")
    write(tmp_path, "envgs", 0, 1, None, kind="noise")
    write(tmp_path, "envgs", 0, 2, 20.0 + 20 * math.log10(2), kind="noise")
    found = mean_corruption_error(stability_of(tmp_path), "envgs")
    assert found == (pytest.approx((2 + (1 + 0.05) / 0.2) / 2), 2)
    assert mean_corruption_error(stability_of(tmp_path), "2dgs") == (pytest.approx(1), 2)


def test_a_method_without_a_baseline_beside_it_has_no_corruption_error(tmp_path: Path) -> None:
    write(tmp_path, "envgs", 0, 1, 20.0)
    assert mean_corruption_error(stability_of(tmp_path), "envgs") is None


def test_a_profile_counts_runs_that_did_not_finish_as_lost(tmp_path: Path) -> None:
    for seed, psnr in enumerate([29.5, 28.0, None, 30.5]):
        write(tmp_path, "envgs", seed, 0, 30.0)
        write(tmp_path, "envgs", seed, 1, psnr)
    lost = drops(stability_of(tmp_path), "envgs")
    assert lost == [[0.5, 2.0, math.inf, -0.5]]
    assert [float(profile(lost, most).mean or 0) for most in (0, 0.5, 2, 1000)] == [0.25, 0.5, 0.75, 0.75]


def sentences(folder: Path) -> Iterator[tuple[str, str]]:
    for item in expectations(stability_of(folder)):
        yield item.verdict, item.text


def test_sentences_say_when_to_take_the_baseline(tmp_path: Path) -> None:
    write_study(tmp_path)
    told = dict(sentences(tmp_path))
    assert told["behind"].startswith("Take 2dgs at severity 3 (3 pixels): envgs is 1.50 dB (95 % interval 1.4")
    assert told["behind"].endswith(", 5 seeds) behind it.")
    assert told["breaks"] == (
        "envgs breaks from severity 2 (2 pixels) on: of 5 runs 5 collapsed (95 % interval of the share 57 to 100 %), "
        "5 of them without any warning."
    )


def test_no_verdict_is_given_that_an_interval_does_not_support(tmp_path: Path) -> None:
    for seed, gain in enumerate([-1.0, 1.1, -0.9, 0.5, -0.6]):
        for severity in (0, 1):
            write(tmp_path, "2dgs", seed, severity, 25.0)
            write(tmp_path, "envgs", seed, severity, 25.0 + gain)
    ((verdict, text),) = sentences(tmp_path)
    assert verdict == "open"
    assert text.startswith("envgs against 2dgs: no verdict at severity 1")


@pytest.mark.parametrize(("seeds", "words"), [(1, "one seed"), (2, "2 seeds")])
def test_too_few_seeds_give_no_verdict(tmp_path: Path, seeds: int, words: str) -> None:
    write_study(tmp_path, seeds)
    told = list(sentences(tmp_path))
    assert [verdict for verdict, _ in told] == ["open"]
    assert f"no verdict from {words}" in told[0][1]


def test_who_fails_is_not_called_ahead(tmp_path: Path) -> None:
    for seed in range(5):
        for severity, (theirs, ours) in enumerate([(25.0, 28.0), (5.0, 6.0)]):
            write(tmp_path, "2dgs", seed, severity, theirs)
            write(tmp_path, "envgs", seed, severity, ours + 0.01 * seed)
    assert "ahead" not in dict(sentences(tmp_path))


def test_a_chart_has_as_many_panels_as_kinds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of five kinds the second row has one panel, and nothing where three others would be."""
    for kind in ("blur", "exposure", "jpeg", "noise", "views"):
        for severity in (0, 1):
            write(tmp_path, "envgs", 0, severity, 25.0 - severity, kind=kind)
    drawn: dict[str, Figure] = {}
    monkeypatch.setattr(Canvas, "write", lambda _, figure, stem, *__: drawn.update({Path(stem).name: figure}))
    study = StabilityStudy.of(*sections_of(tmp_path))
    assert study is not None
    study.draw(Canvas(tmp_path / "out"), 0)
    shown = [axis.get_title("left") for axis in drawn["responses-0-psnr"].axes if axis.axison]
    assert shown == ["blur", "exposure", "jpeg", "noise", "views"]


def test_perturbed_runs_change_nothing_else_in_a_report(tmp_path: Path) -> None:
    later = {"provenance__finished": "2026-02-01T10:00:00+00:00"}
    write_runs(tmp_path / "plain", methods=("2dgs", "envgs"), size=(24, 32))
    write_runs(tmp_path / "both", methods=("2dgs", "envgs"), size=(24, 32))
    for method in ("2dgs", "envgs"):
        for seed in range(3):
            config = record(ROOM, method, seed)["config"] | {"gates": GATES}
            write(tmp_path / "both", method, seed, 1, 9.0, config=config, **later)
    plain, both = (build_report(tmp_path / name, tmp_path / f"{name}-report") for name in ("plain", "both"))
    for file in ("table.csv", "pareto.png", "assets/curves-0-0.js"):
        assert (both.out / file).read_bytes() == (plain.out / file).read_bytes()
    tables = [json.loads((report.out / "table.json").read_text())["sections"][0]["tables"] for report in (plain, both)]
    assert [table for table in tables[1] if table["kind"] != "stability"] == tables[0]
    assert "6 runs" in str(plain)
    assert "12 runs" in str(both)
    assert Stability(both.sections[0].with_perturbed).cell(BLUR, 1, "envgs").unpaired == 0
    assert "-stability" not in plain.page.read_text()
    assert not list(plain.out.rglob("*stability*"))


def test_runs_that_are_all_perturbed_make_a_report(tmp_path: Path) -> None:
    for seed in range(2):
        write(tmp_path, "envgs", seed, 1, 20.0)
    html = build_report(tmp_path, tmp_path / "out").page.read_text()
    assert 'id="section-0-stability"' in html
    assert 'id="section-0-tables"' not in html
    assert "no finished partner" in html


def test_every_number_of_the_page_stands_in_the_csv(tmp_path: Path) -> None:
    write_study(tmp_path)
    report = build_report(tmp_path, tmp_path / "out")
    with (report.out / "stability.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    found = {(row["severity"], row["method"], row["quantity"]): row for row in rows}
    change = found["3", "envgs", "change_psnr"]
    assert float(change["value"]) == pytest.approx(-7.5)
    assert (change["runs"], change["level"], change["kind"]) == ("5", "3 pixels", "blur")
    assert float(found["3", "envgs", "gain_psnr"]["value"]) == pytest.approx(-1.5)
    assert float(found["0", "envgs", "gain_psnr"]["value"]) == pytest.approx(3)
    assert float(found["2", "envgs", "collapsed"]["value"]) == 5
    assert float(found["0", "envgs", "train_seconds"]["std"]) == 0
    assert "−7.50 dB" in report.page.read_text()
    with (report.out / "stability-summary.csv").open(newline="") as stream:
        summary = list(csv.DictReader(stream))
    points = {row["at"]: row["value"] for row in summary if row["quantity"] == "breaking_severity"}
    assert {at: float(value) for at, value in points.items()} == pytest.approx({"0.5": 1.0, "0.0": 2.0})
    assert {row["quantity"] for row in summary} >= {
        *("probability_of_improvement", "mean_corruption_error", "profile", "survival")
    }


def sampled(folder: Path, method: str, seed: int, depth: float, degrees: float, reflected: float | None) -> None:
    """A run and its fixed-ray samples: everything at one depth, turned by an angle, a mirror that shows one gray."""
    write(folder, method, seed, 1, 20.0)
    normal = np.array([math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees))])
    shown = None if reflected is None else np.full((4, 3), reflected)
    run = folder / f"{method}-blur-1-{seed}-100"
    write_samples(run, FixedRaySamples(2.0, np.array([0.0, depth, depth]), np.outer([0, 1, 1], normal), shown))


def test_the_distance_between_seeds_is_that_of_their_models_along_the_same_rays(tmp_path: Path) -> None:
    for seed, (depth, degrees, reflected) in enumerate([(4.0, 0.0, 0.5), (4.1, 1.0, 0.5), (4.5, 30.0, 2.0)]):
        sampled(tmp_path, "envgs", seed, depth, degrees, reflected)
        sampled(tmp_path, "2dgs", seed, depth, degrees, None)
    (tmp_path / "envgs-blur-1-2-100" / "fixed_rays.safetensors").rename(tmp_path / "kept")
    write(tmp_path, "envgs", 3, 1, None)
    cell = stability_of(tmp_path).cell(BLUR, 1, "envgs")
    assert cell.seed_distance("seeds_depth").strata[0] == pytest.approx((0.05, 0.05))  # of two, each from the other
    (tmp_path / "kept").rename(tmp_path / "envgs-blur-1-2-100" / "fixed_rays.safetensors")
    cell = stability_of(tmp_path).cell(BLUR, 1, "envgs")
    assert cell.seed_distance("seeds_depth").strata[0] == pytest.approx((0.15, 0.125, 0.225))
    assert cell.seed_distance("seeds_normal_degrees").strata[0] == pytest.approx((15.5, 15, 29.5), abs=0.05)
    assert cell.seed_distance("seeds_reflected_rmse").strata[0] == pytest.approx((0.25, 0.25, 0.5))
    assert stability_of(tmp_path).cell(BLUR, 1, "2dgs").seed_distance("seeds_reflected_rmse").mean is None
    rows = cells_table(stability_of(tmp_path)).set_index(["severity", "method", "quantity"])
    assert rows.loc[(1, "envgs", "seeds_depth"), "value"] == pytest.approx(1 / 6)
    assert rows.loc[(1, "envgs", "seeds_depth"), "runs"] == 3
    (table,) = stability_tables(stability_of(tmp_path))
    (row,) = (row for row in table.rows if row.method == "envgs, severity 1")
    assert float(row.cells["seeds_depth"].mean) == pytest.approx(1 / 6)


@pytest.mark.parametrize(
    "content", [b"", b"\xff" * 5000, b"\x10" + b"\x00" * 7 + b'{"depth": 1}    ', b"0" * 2_000_000]
)
def test_a_sample_file_that_cannot_be_read_is_left_out(tmp_path: Path, content: bytes) -> None:
    for seed in range(3):
        sampled(tmp_path, "envgs", seed, 4.0 + seed, 0.0, None)
    (tmp_path / "envgs-blur-1-1-100" / "fixed_rays.safetensors").write_bytes(content)
    estimate = stability_of(tmp_path).cell(BLUR, 1, "envgs").seed_distance("seeds_depth")
    assert (estimate.strata, estimate.done, estimate.expected) == (((1.0, 1.0),), 2, 3)


def test_the_page_shows_curves_and_the_worst_views(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    write_runs(runs, methods=("2dgs", "envgs"), seeds=(0, 1), size=(24, 32))
    for method in ("2dgs", "envgs"):
        for seed in (0, 1):
            (source,) = (runs / ROOM / method).glob(f"seed{seed}-*")
            content = json.loads((source / "record.json").read_text())
            content["perturbation"] = {"kind": "blur", "severity": 1, "level": "soft"}
            content["metrics"]["per_view"][3]["psnr"] -= 7.25
            folder = runs / f"blurred-{method}-{seed}"
            write_record(folder, content)
            for name in ("renders", "targets"):
                (folder / name).symlink_to(source / name)
    report = build_report(runs, tmp_path / "out", for_print=True)
    html = report.page.read_text()
    for name in ("charts/stability-0/responses-0-psnr.png", "charts/stability-0/profiles.pdf"):
        assert (report.out / name).stat().st_size > 1000
        assert f'href="{name}"' in html
    assert (report.out / "pictures/stability-0/worst-views-0.png").is_file()
    assert "blur 1, envgs, seed 0, view 003: −7.2 dB" in html or "blur 1, envgs, seed 1, view 003: −7.2 dB" in html


HOSTILE = """=1+1</script><script>window.hacked=1</script>'"|&\\$_{}\x1b[31m"""


@pytest.mark.filterwarnings("ignore:Glyph")  # that charts' font has no control characters
def test_what_perturbed_records_say_stays_text(tmp_path: Path) -> None:
    warning = {"kind": "budget", "step": 5, "part": HOSTILE, "message": HOSTILE}
    perturbation = {"kind": HOSTILE, "severity": 10**18, "level": HOSTILE}
    gates = GATES | {"baseline": HOSTILE}
    for method, psnr in (("envgs", 20.0), ("2dgs", None)):
        config = record(ROOM, method, 0)["config"] | {"gates": gates, "steps": 100}
        changes = {"perturbation": perturbation, "warnings": [warning], "config": config, "dataset": HOSTILE}
        error = {} if psnr else {"error": {"type": HOSTILE, "message": HOSTILE, "log_tail": HOSTILE}}
        write(tmp_path, method, 0, 1, psnr, **changes, **error)
    report = build_report(tmp_path, tmp_path / "out", for_print=True)
    html = report.page.read_text()
    assert "<script>" not in html
    assert "=1+1&lt;/script&gt;" in html
    for name in ("stability.csv", "stability-summary.csv"):
        with (report.out / name).open(newline="") as stream:
            cells = [cell for row in csv.reader(stream) for cell in row]
        assert not [cell for cell in cells if cell.startswith(("=", "@", "+")) or not cell.isprintable()]
    for name in ("table.md", "table.tex"):
        assert all(line.isprintable() for line in (report.out / name).read_text().split("\n"))
    assert (report.out / "table.tex").read_text().isascii()


def test_a_severity_beyond_all_numbers_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "a", "envgs", 0, 0, 20.0)
    write(tmp_path / "b", "envgs", 0, 1, 20.0, perturbation={"kind": "blur", "severity": 10**30, "level": ""})
    (broken,) = build_report(tmp_path, tmp_path / "out").broken
    assert "perturbation.severity" in broken.reason
