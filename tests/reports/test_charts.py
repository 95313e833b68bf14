"""The reports' charts: the front against its definition, names that do not cover one another, curves against pandas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from reports_runs import METHODS, record, run_folder, write_failure, write_record, write_runs
from scipy import stats

from envgs_bench.parts import MethodCard
from envgs_bench.reports.charts.curves import merged_curves, read_curve, training_curves
from envgs_bench.reports.charts.drawn import Canvas
from envgs_bench.reports.charts.label_placement import Box, place_labels
from envgs_bench.reports.charts.palette import styles
from envgs_bench.reports.charts.pareto import Point, front, points
from envgs_bench.reports.charts.pareto_chart import draw_charts, panel_rows
from envgs_bench.reports.numbers.runs import read_run, read_runs
from envgs_bench.reports.numbers.swept_settings import sweeps
from envgs_bench.reports.tables.columns import FLIP, FRAME_MS, MEGABYTES, PRIMITIVES, PSNR, in_region
from envgs_bench.reports.tables.sections import split_sections


def point(x: float, y: float, done: int = 3, label: str = "") -> Point:
    return Point(label, x, y, None, None, done, 3)


coordinates = st.lists(st.tuples(st.integers(1, 6), st.integers(1, 6)), max_size=12)


@given(coordinates)
def test_the_front_is_what_nothing_dominates(places: list[tuple[int, int]]) -> None:
    """A point is off the front if and only if another is as good in both columns and better in one."""
    given_points = [point(x, y) for x, y in places]
    found = front(given_points, FRAME_MS, PSNR)
    for p in given_points:
        dominated = any(q.x <= p.x and q.y >= p.y and (q.x, q.y) != (p.x, p.y) for q in given_points)
        assert (p in found) != dominated
    assert [p.x for p in found] == sorted(p.x for p in found)


def test_less_error_is_better_on_the_front() -> None:
    good, bad = point(10, 0.1), point(20, 0.2)
    assert front([bad, good], FRAME_MS, FLIP) == [good]
    assert front([bad, good], FRAME_MS, PSNR) == [good, bad]


def test_a_method_that_failed_somewhere_dominates_no_other() -> None:
    lucky, solid = point(5, 40, done=2), point(10, 30)
    assert front([lucky, solid], FRAME_MS, PSNR) == [solid]


def test_one_swept_setting_is_a_line() -> None:
    """Rows of one code that differ in one number; a grid of two settings has a line for each sweep of either."""
    filtered = {
        f"envgs [beta_filter={share}]": {"kind": "envgs", "beta_filter": share} for share in ("0.9", "0", "0.5")
    }
    others = {"3dgs": {"kind": "3dgs"}, "2dgs": {"kind": "2dgs", "steps": "9"}}
    line = [f"envgs [beta_filter={share}]" for share in ("0", "0.5", "0.9")]
    assert sweeps(filtered | others) == [line]
    grid = {f"m [{a} {b}]": {"kind": "m", "a": a, "b": b} for a in "12" for b in "12"}
    assert {tuple(line) for line in sweeps(grid)} == {
        *(("m [1 1]", "m [2 1]"), ("m [1 2]", "m [2 2]")),
        *(("m [1 1]", "m [1 2]"), ("m [2 1]", "m [2 2]")),
    }


def test_other_differences_are_no_sweep() -> None:
    ablated = {"envgs": {"kind": "envgs", "joint": "True", "mono": "0.01"}}
    ablated |= {"envgs_no_joint": ablated["envgs"] | {"joint": "False"}}  # no number
    ablated |= {"envgs_no_mono": ablated["envgs"] | {"mono": "0"}}  # a configuration of its own
    assert sweeps(ablated) == []


def test_colors_and_marks_tell_methods_apart() -> None:
    cards = {name: MethodCard(name, name, order, "#CC0000") for order, name in enumerate(METHODS)}
    chosen = styles([*METHODS, "a", "b", "c", "d"], cards)
    assert len({style.color for style in chosen.values()}) == 8
    assert len({style.marker for style in chosen.values()}) == 8
    assert chosen["3dgs"].color == "#CC0000"  # the first of its family has its color, the others are lighter
    assert chosen["envgs"] == styles(["envgs"], cards)["envgs"]
    variants = styles(["envgs [steps=1]", "envgs [steps=2]"], cards)
    assert variants["envgs [steps=1]"] == chosen["envgs"]
    assert variants["envgs [steps=2]"].marker == chosen["envgs"].marker
    assert variants["envgs [steps=2]"].color != chosen["envgs"].color


@given(st.lists(st.tuples(st.integers(40, 960), st.integers(40, 760)), max_size=12, unique=True))
def test_names_stay_in_the_frame_and_optional_ones_cover_nothing(marks: list[tuple[float, float]]) -> None:
    frame = Box(0, 0, 1000, 800)
    boxes = [b for b in place_labels(marks, [(60, 14)] * len(marks), [False] * len(marks), frame) if b is not None]
    for i, box in enumerate(boxes):
        assert box.outside(frame) * 10 < 0.1 * 60 * 14
        assert all(box.overlap(other) <= 0.1 * 60 * 14 for other in boxes[:i])


def test_needed_names_are_always_placed_and_apart_where_there_is_room() -> None:
    marks = [(100.0, 100.0), (106.0, 100.0), (300.0, 300.0)]
    first, second, third = place_labels(marks, [(60, 14)] * 3, [True] * 3, Box(0, 0, 400, 400))
    assert first is not None
    assert second is not None
    assert third is not None
    assert first.overlap(second) == 0
    assert third == Box(309, 293, 369, 307)  # right of its mark


def test_the_chart_has_a_row_a_data_set_and_a_panel_a_region(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", ("toy/chrome_room", "toy/diffuse_room"), pictures=False)
    write_failure(tmp_path / "runs", "toy/chrome_room", "single_set", 0, "diverged", "nan")
    sections = split_sections(read_runs(tmp_path / "runs")[0])
    rows = panel_rows(sections, FRAME_MS, [PSNR, in_region(PSNR, "near_field")])
    assert [[p.accuracy.key for p in row] for row in rows] == [["psnr", "psnr_near_field"], ["psnr"]]


def test_every_accuracy_is_drawn_against_every_cost(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", seeds=(0,), pictures=False)
    canvas = Canvas(tmp_path, pdf=True)
    files = draw_charts(split_sections(read_runs(tmp_path / "runs")[0]), canvas, every_pair=True)
    accuracies = ("psnr", "ssim", "flip", "psnr_reflective", "psnr_near_field")  # LPIPS was not computed
    costs = ("frame_ms", "train_seconds", "model_bytes", "primitives")
    stems = {"pareto", *(f"charts/{accuracy}-{cost}" for accuracy in accuracies for cost in costs)}
    assert {(chart.png, chart.pdf) for chart in files} == {(f"{stem}.png", f"{stem}.pdf") for stem in stems}
    for chart in files:
        assert (tmp_path / (chart.pdf or "")).read_bytes().startswith(b"%PDF")
        with Image.open(tmp_path / chart.png) as image:
            assert np.asarray(image.convert("L")).std() > 8


def test_unless_it_is_for_print_one_chart_is_drawn_as_a_picture(tmp_path: Path) -> None:
    write_runs(tmp_path / "runs", seeds=(0,), pictures=False)
    (chart,) = draw_charts(split_sections(read_runs(tmp_path / "runs")[0]), Canvas(tmp_path))
    assert (chart.png, chart.pdf) == ("pareto.png", None)
    assert not list(tmp_path.glob("*.pdf"))


def test_a_method_without_primitives_is_on_no_logarithmic_axis(tmp_path: Path) -> None:
    write_runs(tmp_path, methods=("envgs",), seeds=(0,), pictures=False)
    empty = record("toy/chrome_room", "mean", 0)
    empty["cost"]["primitives"] = {"base": 0}
    write_record(tmp_path / "mean", empty)
    sections = split_sections(read_runs(tmp_path)[0])
    (((panel,),),) = (panel_rows(sections, PRIMITIVES, [PSNR]),)
    assert [place.label for place in panel.places] == ["envgs"]


def test_many_data_sets_are_drawn_as_averages(tmp_path: Path) -> None:
    write_runs(tmp_path, tuple(f"toy/room{i}" for i in range(6)), ("3dgs", "envgs"), (0,), pictures=False)
    rows = panel_rows(split_sections(read_runs(tmp_path)[0]), FRAME_MS, [PSNR])
    assert [row[0].table.title for row in rows] == ["toy"]


def test_points_carry_intervals_in_printed_units(tmp_path: Path) -> None:
    write_runs(tmp_path, methods=("envgs",), pictures=False)
    section = split_sections(read_runs(tmp_path)[0])[0]
    (found,) = points(section.subjects[0], MEGABYTES, PSNR)
    values = section.tidy.query("metric == 'model_bytes'")["value"] / 1e6
    assert found.x == pytest.approx(values.mean())
    assert found.x_interval is not None
    ends = stats.ttest_1samp(values, 0).confidence_interval(0.95)
    assert found.x_interval == pytest.approx((ends.low, ends.high))


def test_curves_are_the_mean_and_the_extremes_over_seeds(tmp_path: Path) -> None:
    write_runs(tmp_path, methods=("envgs",), pictures=False)
    frames = [pd.read_csv(path) for path in tmp_path.rglob("curve.csv")]
    together = pd.concat(frames).groupby("step")
    ((_, (curve,)),) = training_curves(split_sections(read_runs(tmp_path)[0])[0])
    assert curve["step"] == sorted(together.groups)
    for name, expected in (("mean", together.mean()), ("low", together.min()), ("high", together.max())):
        np.testing.assert_allclose(curve["psnr"][name], expected["psnr"], rtol=1e-4)
    sets = pd.concat([f.assign(total=f["primitives_base"] + f["primitives_env"]) for f in frames])
    np.testing.assert_allclose(curve["primitives"]["mean"], sets.groupby("step")["total"].mean(), rtol=1e-4)
    assert curve["skipped_steps"]["low"][-1] == 0
    assert curve["skipped_steps"]["high"][-1] == 2 * (1500 // 400)


def test_a_seed_that_stopped_early_counts_as_far_as_it_came() -> None:
    short = {"step": np.array([1.0]), "psnr": np.array([10.0])}
    long = {"step": np.array([1.0, 2.0]), "psnr": np.array([20.0, 30.0])}
    merged = merged_curves([short, long])
    assert merged["psnr"] == {"mean": [15.0, 30.0], "low": [10.0, 30.0], "high": [20.0, 30.0]}


@pytest.mark.parametrize("content", [None, "", "step,psnr\n", "psnr\n1\n", "step,psnr\n1,two\n", "\x00\x01"])
def test_an_unreadable_curve_is_none(tmp_path: Path, content: str | None) -> None:
    run = run_folder(tmp_path, "toy/chrome_room", "envgs", 0)
    write_record(run, record("toy/chrome_room", "envgs", 0))
    if content is not None:
        (run / "curve.csv").write_text(content)
    assert read_curve(read_run(run)) is None
