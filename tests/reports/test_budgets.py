"""Budgets in reports: curves with their knees, maps, sentences and numbers, from made-up records."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import pytest
from reports_runs import record, sections_of, write_record, write_runs

from envgs_bench.reports import build_report
from envgs_bench.reports.numbers.intervals import mean_interval
from envgs_bench.reports.studies.budgets.budgets import BudgetCurve
from envgs_bench.reports.studies.budgets.sentences import curve_sentence, map_sentence, rate_sentence
from envgs_bench.reports.studies.budgets.study import BudgetStudy

ROOM = "toy/chrome_room"


def write(
    folder: Path, method: str, psnr: float | None, seed: int = 0, budget: dict[str, Any] | None = None, **own: Any
) -> None:
    """A run of this PSNR within a budget, which did not finish where that is None."""
    content = record(ROOM, method, seed)
    content["config"]["budget"] = budget
    content["config"]["method"] = {"name": method, "kind": method, "settings": own}
    if psnr is None:
        content |= {"status": "diverged", "error": {"type": "Diverged", "message": "lost", "log_tail": ""}}
        content |= {"metrics": None, "masked": {}, "timing": None, "cost": None}
    else:
        content["metrics"]["mean"] |= {"psnr": psnr, "lpips": None}
        limit = (budget or {}).get("primitives") or round(9000 / (1 + 100 * own.get("prune_error", 0.0)))
        content["cost"]["primitives"] = {"base": limit - 100, "env": 90}
    write_record(folder / f"{method}-{seed}-{budget}-{own}".replace("/", "_"), content)


def write_curve(folder: Path, values: dict[int, list[float | None]], method: str = "envgs") -> None:
    """Budget in primitives -> PSNR of each seed."""
    for primitives, by_seed in values.items():
        for seed, psnr in enumerate(by_seed):
            write(folder, method, psnr, seed, {"primitives": primitives, "mb": None})


def found(folder: Path) -> BudgetStudy:
    (section,) = sections_of(folder)
    study = BudgetStudy.of(section)
    assert study is not None
    return study


def the_curve(folder: Path) -> BudgetCurve:
    (curve,) = found(folder).curves
    return curve


def test_the_knee_is_the_smallest_budget_that_surely_loses_no_more(tmp_path: Path) -> None:
    """Seeds differ by decibels, the losses paired by seed do not; 1,000 primitives lose 0.05, 500 perhaps 0.12."""
    best = [30.0, 27.0, 25.0]
    loses = {250: [1.0, 1.1, 1.2], 500: [0.06, 0.10, 0.12], 1000: [0.04, 0.05, 0.06], 2000: [0.0, 0.0, 0.0]}
    write_curve(tmp_path, {at: [b - x for b, x in zip(best, lost, strict=True)] for at, lost in loses.items()})
    curve = the_curve(tmp_path)
    assert [row.limit for row in curve.rows] == [250, 500, 1000, 2000]
    knee = curve.knee
    assert (knee.row, knee.best) == (curve.rows[2], curve.rows[3])
    interval = mean_interval([[-0.04, -0.05, -0.06]])
    assert interval is not None
    assert knee.loss.interval == pytest.approx(interval)
    assert curve_sentence(curve) == (
        "envgs: 1,000 primitives, 0.05 dB below the best (2,000 primitives), by the interval at most 0.07."
    )


def test_a_curve_that_falls_again_has_its_knee_before_or_at_its_best(tmp_path: Path) -> None:
    write_curve(tmp_path, {250: [20.0, 20.1, 20.2], 500: [21.0, 21.1, 21.2], 1000: [20.5, 20.6, 20.7]})
    curve = the_curve(tmp_path)
    assert curve.knee.row == curve.knee.best == curve.rows[1]
    assert curve_sentence(curve) == "envgs: 500 primitives, the best; any less may lose more than 0.1 dB."


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({250: [20.0, 20.1, 20.2], 500: [21.0, 21.1, 21.2]}, "still better at the largest budget"),
        ({250: [21.0, 21.0], 500: [21.0, 21.05]}, "2 of at least 3 seeds"),
        ({250: [None, None, None], 500: [None, None, None]}, "no run finished"),
        ({250: [21.0, 21.0, 21.0, None], 500: [21.0, 21.0, 21.0, 21.1]}, "still better at the largest budget"),
    ],
)
def test_there_is_no_knee_without_evidence(tmp_path: Path, values: dict[int, list[float | None]], why: str) -> None:
    write_curve(tmp_path, values)
    knee = the_curve(tmp_path).knee
    assert (knee.row, knee.why) == (None, why)
    assert why in curve_sentence(the_curve(tmp_path))


def test_curves_are_of_rows_that_differ_in_the_budget_alone(tmp_path: Path) -> None:
    for seed in range(3):
        for degree in (2, 3):
            for mb in (0.5, 1.0):
                write(tmp_path, "2dgs", 20.0 + mb, seed, {"primitives": None, "mb": mb}, sh_degree=degree)
        write(tmp_path, "2dgs", 25.0, seed, None, sh_degree=2)
        write(tmp_path, "3dgs", 24.0, seed, {"primitives": 400, "mb": None})
    curves = found(tmp_path).curves
    assert [(c.method, [r.limit for r in c.rows]) for c in curves] == [
        ("2dgs [sh_degree=2]", [0.5, 1.0, math.inf]),
        ("2dgs [sh_degree=3]", [0.5, 1.0]),
    ]
    assert curve_sentence(curves[0]).startswith(
        "2dgs [sh_degree=2]: no knee, still better at the largest budget; best: no"
    )


def test_prunings_make_a_curve_from_the_most_that_they_may_cost_to_none(tmp_path: Path) -> None:
    """With 100·prune_error + 1 times fewer primitives each; by opacity every PSNR has half of the error."""
    for by, scale in (("importance", 1.0), ("opacity", 0.5)):
        for error in (0.0, 0.01, 0.03, 0.07):
            write(tmp_path, "2dgs", 22.0 - 20 * error, 0, prune_by=by, prune_error=scale * error)
    importance, opacity = found(tmp_path).curves
    assert [row.limit for row in importance.rows] == [0.07, 0.03, 0.01, math.inf]
    assert curve_sentence(importance).endswith("1 of at least 3 seeds; best: no prunings.")
    rate = opacity.rate_against(importance)
    assert rate is not None
    assert 0.2 < rate < 0.9
    assert rate_sentence(opacity, [importance, opacity]).startswith("2dgs [prune_by=opacity]: ")


def test_frame_times_make_a_curve(tmp_path: Path) -> None:
    for seed in range(3):
        for frame_ms, psnr in ((2.5, 20.0), (5.0, 21.0), (10.0, 21.0)):
            write(tmp_path, "envgs", psnr, seed, {"primitives": None, "mb": None, "frame_ms": frame_ms})
    (curve,) = found(tmp_path).curves
    assert curve_sentence(curve) == "envgs: 5 ms a frame, the best; any less may lose more than 0.1 dB."


def write_map(folder: Path) -> None:
    """The best is 1,000 × 100, and 500 × 200 was not tried."""
    values = {(500, 50): 20.0, (500, 100): 20.5, (1000, 50): 20.7, (1000, 100): 21.0, (1000, 200): 20.9}
    for seed in range(3):
        for (base, env), psnr in values.items():
            own = {"max_primitives": base, "env_max_primitives": env}
            write(folder, "envgs", psnr + seed / 100, seed, {"primitives": 10_000, "mb": None}, **own)


def test_a_map_has_a_cell_for_every_pair_of_bounds(tmp_path: Path) -> None:
    write_map(tmp_path)
    (made,) = found(tmp_path).maps
    assert not found(tmp_path).curves
    assert (made.base, made.env, made.best) == ([500, 1000], [50, 100, 200], (1000, 100))
    assert made.estimate(500, 200).mean is None
    assert float(made.estimate(500, 50).mean or 0) == pytest.approx(20.01)
    assert made.knee is None
    assert map_sentence(made) == "envgs: best with at most 1,000 in the base and 100 in the environment, 21.01 dB."


def test_a_maps_knee_is_the_smallest_sum_that_surely_loses_no_more(tmp_path: Path) -> None:
    write_map(tmp_path)
    for seed in range(3):  # of two that tie, the smaller sum
        for env, lost in ((25, 0.2), (30, 0.05), (40, 0.01)):
            own = {"max_primitives": 1000, "env_max_primitives": env}
            write(tmp_path, "envgs", 21.0 - lost + seed / 100, seed, {"primitives": 10_000, "mb": None}, **own)
    (made,) = found(tmp_path).maps
    assert made.knee == (1000, 30)
    assert map_sentence(made).endswith("; 1,000 and 30 are 0.05 below.")


def test_the_report_has_all_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("envgs_bench.reports.report.draw_charts", lambda *_, **__: [])  # those of other parts
    write_curve(tmp_path / "runs", {at: [20 - 400 / at, 21 - 400 / at, 22 - 400 / at] for at in (250, 500, 1000)})
    write_curve(tmp_path / "runs", {at: [19.0, 20.0, 21.0] for at in (250, 500, 1000)}, "2dgs")
    write_map(tmp_path / "map")
    out = tmp_path / "out"
    html = build_report(tmp_path, out, for_print=True).page.read_text()
    assert 'id="section-0-budgets"' in html
    assert "<li>2dgs: 250 primitives, " in html
    assert "<li>envgs: no knee, still better at the largest budget; best: 1,000 primitives.</li>" in html
    assert "<li>envgs: best with at most 1,000 in the base" in html
    for name in ("curves-0", "map-0"):
        assert f"charts/budgets-0/{name}.png" in html
        assert (out / f"charts/budgets-0/{name}.pdf").is_file()
    rows = list(csv.DictReader((out / "budgets.csv").open()))
    psnr = {
        (r["method"], r["limit"]): r for r in rows if r["quantity"] == "psnr" and r["budget"] == "budget.primitives"
    }
    assert float(psnr["envgs", "500.0"]["value"]) == pytest.approx(20.2)
    assert {r["value"] for r in rows if r["quantity"] == "knee" and r["method"] == "2dgs"} == {"250.0"}
    cells = [r for r in rows if r["env_limit"] and r["quantity"] == "psnr"]
    assert len(cells) == 5


def test_without_budgets_there_is_no_such_part(tmp_path: Path) -> None:
    write_runs(tmp_path, methods=("2dgs",), seeds=(0,), pictures=False)
    (section,) = sections_of(tmp_path)
    assert BudgetStudy.of(section) is None


def test_curves_are_compared_by_their_rate(tmp_path: Path) -> None:
    """A method that takes half the primitives for the same PSNR; each has 10 fewer than its budget."""
    quality = [20.0, 21.0, 21.7, 22.0]
    for method, limits in (("2dgs", (1010, 2010, 4010, 8010)), ("envgs", (510, 1010, 2010, 4010))):
        write_curve(tmp_path, {at: [q] * 3 for at, q in zip(limits, quality, strict=True)}, method)
    study = found(tmp_path)
    first, second = study.curves
    assert rate_sentence(first, study.curves) == ""
    words = "50% fewer" if second.method == "envgs" else "100% more"
    assert rate_sentence(second, study.curves) == (
        f"{second.method}: {words} primitives than {first.method} at equal PSNR (BD-rate)."
    )
    table = study.csv()["budgets"]
    rates = table[table.quantity.str.startswith("bd_rate")].set_index("method").value.to_dict()
    assert rates == pytest.approx({"2dgs": 1.0, "envgs": -0.5}, abs=1e-3)
