"""Candidates: paired by seed with the method as it is, judged by the rules that the documentation states."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from reports_runs import record, sections_of, tables_of, titled, write_record

from envgs_bench.reports import report
from envgs_bench.reports.studies.candidates.candidates import UNKNOWN, Candidates, DecidingPart
from envgs_bench.reports.studies.candidates.study import CandidateStudy
from envgs_bench.reports.tables.sections import Section

ROOM, SKY, TABLE = "toy/chrome_room", "toy/sky_ball", "toy/lacquered_table"

Views = Sequence[float]  # PSNR of each


def write(
    folder: Path,
    dataset: str,
    seed: int,
    views: Views | None,
    coverage: float = 1.5,
    override: bool | None = None,
    method: str = "envgs",
    scored_on: str = "validation",
    steps: int = 3000,
    known: float | None = None,
) -> None:
    """A run of views of these scores, which did not finish where they are None; set up by an override unless at 1.5.

    `known` is the PSNR of what training views show, where the data set knows it.
    """
    content = record(dataset, method, seed, scored_on=scored_on, steps=steps)
    content["config"] |= {"method": {"name": method, "settings": {"min_coverage": coverage}}}
    if coverage != 1.5 if override is None else override:
        content["overrides"].append(f"method.settings.min_coverage={coverage}")
    if views is None:
        content |= {"status": "diverged", "error": {"type": "Diverged", "message": "lost", "log_tail": ""}}
        content |= {"metrics": None, "masked": {}, "timing": None, "cost": None}
    else:
        content["metrics"]["mean"]["psnr"] = float(np.mean(views))
        content["metrics"]["per_view"] = [
            {"view": f"{i:03d}", "psnr": psnr, "ssim": 0.9, "flip": 0.1, "lpips": None} for i, psnr in enumerate(views)
        ]
        if known is not None:
            content["masked"]["covisible"] = {"fraction": 0.97, "psnr": known, "ssim": 0.9, "flip": 0.1, "per_view": []}
    write_record(folder / f"{len(list(folder.glob('*'))):03d}", content)


def write_all(folder: Path, runs: Mapping[float, Mapping[str, Sequence[float | None]]]) -> None:
    """Runs of two equal views by min_coverage and data set, a value a seed."""
    for coverage, scores in runs.items():
        for dataset, values in scores.items():
            for seed, psnr in enumerate(values):
                write(folder, dataset, seed, None if psnr is None else (psnr, psnr), coverage)


def studied(section: Section) -> tuple[Candidates, ...]:
    study = CandidateStudy.of(section)
    return study.found if study is not None else ()


def the_candidates(folder: Path) -> Candidates:
    (section,) = sections_of(folder)
    (found,) = studied(section)
    return found


# As it is, a run varies by √(0.02) = 0.14 dB between seeds on either data set; its candidates do not add to that.
PLAIN = {ROOM: (24.0, 24.2), SKY: (20.0, 20.2)}


@pytest.mark.parametrize(
    ("scores", "verdict", "loses"),
    [
        pytest.param({ROOM: (24.3, 24.5), SKY: (20.0, 20.2)}, "keep", [], id="gains 0.15 as a mean, loses nothing"),
        pytest.param({ROOM: (24.5, 24.7), SKY: (19.9, 20.1)}, "keep", [], id="what it loses seeds lose too"),
        pytest.param({ROOM: (24.1, 24.3), SKY: (20.0, 20.2)}, "no gain", [], id="0.05 may be chance"),
        pytest.param({ROOM: (24.9, 24.1), SKY: (20.0, 20.2)}, "not shown", [], id="0.2, by one seed alone"),
        pytest.param({ROOM: (26.0, 26.2), SKY: (19.8, 20.0)}, "loses", [SKY], id="a mean of 0.9 makes up for nothing"),
        pytest.param({ROOM: (24.3, None), SKY: (20.0, 20.2)}, "incomplete", [], id="a run diverged"),
        pytest.param({ROOM: (24.3, 24.5)}, "incomplete", [], id="not tried everywhere"),
        pytest.param({ROOM: (24.3,), SKY: (20.0,)}, "incomplete", [], id="one seed"),
    ],
)
def test_a_candidate_is_kept_that_gains_and_loses_nowhere(
    tmp_path: Path, scores: dict[str, Sequence[float | None]], verdict: str, loses: list[str]
) -> None:
    write_all(tmp_path, {1.5: PLAIN, 2.0: scores})
    found = the_candidates(tmp_path)
    assert found.base == "envgs"
    (candidate,) = found.rows
    assert (found.verdict(candidate), list(found.losses(candidate))) == (verdict, loses)


def test_what_is_undecided_says_where_runs_are_lacking(tmp_path: Path) -> None:
    few = {ROOM: (24.3, 24.5), SKY: (20.0, None), TABLE: (27.0,)}
    write_all(tmp_path, {1.5: {**PLAIN, TABLE: (27.0, 27.1)}, 2.0: few})
    found = the_candidates(tmp_path)
    (candidate,) = found.rows
    assert found.lacking(candidate) == [TABLE, SKY]
    (section,) = sections_of(tmp_path)
    remarks = titled(section, "envgs: candidates less envgs as it is").remarks
    (said,) = [remark for remark in remarks if "undecided" in remark]
    assert said.endswith(f" on {TABLE}, {SKY}.")


def test_differences_are_those_of_the_same_seed(tmp_path: Path) -> None:
    """Seed 2, which the candidate alone has, is compared with nothing."""
    write_all(tmp_path, {1.5: {ROOM: (20.0, 25.0)}, 2.0: {ROOM: (20.3, 25.5, 99.0)}})
    found = the_candidates(tmp_path)
    (candidate,) = found.rows
    assert found.difference(candidate, ROOM).strata[0] == pytest.approx((0.3, 0.5))
    assert found.gain(candidate, ROOM) == pytest.approx(0.4)
    assert found.gain(found.base, ROOM) == 0


def test_the_spread_of_a_run_is_pooled_over_rows(tmp_path: Path) -> None:
    rows = {1.0: (24.0, 24.4, 24.1), 1.5: (23.0, 23.2), 2.0: (25.0,)}
    write_all(tmp_path, {coverage: {ROOM: values} for coverage, values in rows.items()})
    several = [np.asarray(values) for values in rows.values() if len(values) > 1]
    residuals = np.concatenate([values - values.mean() for values in several])
    expected = np.sqrt((residuals**2).sum() / (len(residuals) - len(several)))
    assert the_candidates(tmp_path).spreads == pytest.approx({ROOM: expected})


def test_one_view_that_decides_is_named(tmp_path: Path) -> None:
    """View 1 gains 3 dB on either seed and the others lose 0.2; in the room it gains as much beside others' 0.3."""
    for seed, start in enumerate((20.0, 20.1)):
        write(tmp_path, SKY, seed, [start + i for i in range(4)])
        write(tmp_path, SKY, seed, [start - 0.2, start + 4.0, start + 1.8, start + 2.8], 2.0)
        write(tmp_path, ROOM, seed, [start + i for i in range(4)])
        write(tmp_path, ROOM, seed, [start + 0.3, start + 4.0, start + 2.3, start + 3.3], 2.0)
    found = the_candidates(tmp_path)
    (candidate,) = found.rows
    (part,) = found.deciding_parts(candidate)
    assert part == DecidingPart(SKY, "view 001", pytest.approx(0.6), pytest.approx(-0.2))  # type: ignore[arg-type]


def test_what_no_training_view_shows_is_named_where_it_decides(tmp_path: Path) -> None:
    """Of what training views show the sky loses 0.4 dB, though 0.3 better in all; the room has no such region."""
    for seed, start in enumerate((20.0, 20.1)):
        write(tmp_path, ROOM, seed, [start, start])
        write(tmp_path, ROOM, seed, [start + 0.3, start + 0.3], 2.0)
        write(tmp_path, SKY, seed, [start, start], known=start + 2)
        write(tmp_path, SKY, seed, [start + 0.3, start + 0.3], 2.0, known=start + 1.6)
    found = the_candidates(tmp_path)
    (candidate,) = found.rows
    (part,) = found.deciding_parts(candidate)
    assert part == DecidingPart(SKY, UNKNOWN, pytest.approx(0.3), pytest.approx(-0.4))  # type: ignore[arg-type]
    (section,) = sections_of(tmp_path)
    remarks = titled(section, "envgs: candidates less envgs as it is").remarks
    said = f"{candidate} hangs on what no training view shows of toy/sky_ball: +0.30 dB, and −0.40 without."
    assert said in remarks


def test_each_data_set_left_out_is_served_by_what_the_others_choose(tmp_path: Path) -> None:
    """2.0 is the best by the sky alone: without it the others choose 1.0, which costs the sky 0.1 dB."""
    write_all(
        tmp_path,
        {
            1.5: {ROOM: (24.0, 24.1), TABLE: (27.0, 27.1), SKY: (20.0, 20.1)},
            1.0: {ROOM: (24.3, 24.4), TABLE: (27.3, 27.4), SKY: (19.9, 20.0)},
            2.0: {ROOM: (24.1, 24.2), TABLE: (27.1, 27.2), SKY: (22.0, 22.1)},
        },
    )
    found = the_candidates(tmp_path)
    low, high = found.rows  # which change nothing but what sets the rows apart
    assert [found.chosen_without(dataset) for dataset in (ROOM, TABLE, SKY)] == [high, high, low]
    (section,) = sections_of(tmp_path)
    remark = titled(section, "envgs: candidates less envgs as it is").remarks[-1]
    assert f"{high} (2 of 3 times), {low} (1 of 3 times)" in remark
    assert "+0.03 dB" in remark  # (0.1 + 0.1 − 0.1) / 3


def test_runs_that_no_override_set_up_are_the_method_as_it_is(tmp_path: Path) -> None:
    """Also where an override says what the method is anyway; of a grid without such runs nothing can be said."""
    for seed in (0, 1):
        write(tmp_path / "a", ROOM, seed, (24.0, 24.0), 1.5, override=seed == 1)
        write(tmp_path / "a", ROOM, seed, (25.0, 25.0), 1.0)
        write(tmp_path / "b", ROOM, seed, (24.0, 24.0), 1.5, override=True)
        write(tmp_path / "b", ROOM, seed, (25.0, 25.0), 1.0)
    assert the_candidates(tmp_path / "a").base == "envgs"
    (section,) = sections_of(tmp_path / "b")
    assert studied(section) == ()


def test_a_candidate_is_called_by_what_it_changes(tmp_path: Path) -> None:
    """Rows differ in two settings, of which either candidate changes one."""
    for number, (coverage, degree) in enumerate(((1.5, 2), (2.0, 2), (1.5, 3))):
        content = record(ROOM, "envgs", 0, scored_on="validation")
        settings = {"min_coverage": coverage, "sh_degree": degree}
        content["config"] |= {"method": {"name": "envgs", "settings": settings}}
        content["overrides"] += ["method.settings.…"] if number else []
        write_record(tmp_path / str(number), content)
    assert the_candidates(tmp_path).rows == ("envgs [sh_degree=3]", "envgs [min_coverage=2.0]")


def test_without_runs_of_the_method_as_it_is_rows_tell_all_that_varies(tmp_path: Path) -> None:
    """Or where these disagree, as they do about the number of steps."""
    for seed, (coverage, steps) in enumerate(((1.5, 3000), (1.5, 9000), (2.0, 3000))):
        write(tmp_path / "some", ROOM, seed, (24.0, 24.0), coverage, steps=steps)
        write(tmp_path / "none", ROOM, seed, (24.0, 24.0), coverage, steps=steps, override=True)
    (some,), (none,) = sections_of(tmp_path / "some"), sections_of(tmp_path / "none")
    assert some.methods == ["envgs [steps=3000]", "envgs [steps=9000]", "envgs [min_coverage=2.0, steps=3000]"]
    assert none.methods == [f"envgs [min_coverage={c}, steps={n}]" for c, n in ((1.5, 3000), (1.5, 9000), (2.0, 3000))]


def test_other_methods_and_other_steps_are_candidates_of_their_own(tmp_path: Path) -> None:
    for seed in (0, 1):
        for steps in (3000, 9000):
            write(tmp_path, ROOM, seed, (24.0, 24.0), steps=steps)
            write(tmp_path, ROOM, seed, (24.5, 24.5), 2.0, steps=steps)
        write(tmp_path, ROOM, seed, (22.0, 22.0), method="envmap")
    (section,) = sections_of(tmp_path)
    assert [(found.name, len(found.rows)) for found in studied(section)] == [("envgs", 1), ("envgs", 1)]


def test_nothing_is_chosen_on_test_views(tmp_path: Path) -> None:
    for seed in (0, 1):
        write(tmp_path, ROOM, seed, (24.0, 24.0), scored_on="test")
        write(tmp_path, ROOM, seed, (25.0, 25.0), 2.0, scored_on="test")
    (section,) = sections_of(tmp_path)
    assert studied(section) == ()
    assert CandidateStudy.name not in {table.kind for table in tables_of(section)}


def test_the_report_shows_candidates_first_with_the_rules_and_verdicts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "draw_charts", lambda *_, **__: [])
    write_all(tmp_path / "runs", {1.5: PLAIN, 2.0: {ROOM: (24.3, 24.5), SKY: (20.0, 20.2)}})
    report.build_report(tmp_path / "runs", tmp_path / "out")
    text = (tmp_path / "out/table.md").read_text()
    assert text.index("candidates less envgs as it is") < text.index("PSNR ↑")
    assert "envgs [min_coverage=2.0]: may be kept." in text
    assert "lacks more than a run varies by its seed there" in text
    page = (tmp_path / "out/index.html").read_text()
    assert "may be kept" in page
    (section,) = json.loads((tmp_path / "out/table.json").read_text())["sections"]
    (table,) = [table for table in section["tables"] if table["kind"] == CandidateStudy.name]
    assert [row["method"] for row in table["rows"]] == ["envgs [min_coverage=2.0]"]
