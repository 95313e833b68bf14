"""Ablation ladders: paired by seed, the cheapest that is not shown to be worse than the best, alike everywhere."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Sequence
from html import unescape
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
from reports_runs import record, row_of, sections_of, tables_of, titled, write_record
from scipy import stats

from envgs_bench.reports import report
from envgs_bench.reports.charts.drawn import Canvas
from envgs_bench.reports.charts.palette import styles
from envgs_bench.reports.studies.ablation_ladder.chart import draw_ladders, steps
from envgs_bench.reports.studies.ablation_ladder.ladder import Ladder, Variant
from envgs_bench.reports.studies.ablation_ladder.recommendation import recommendation
from envgs_bench.reports.studies.ablation_ladder.study import AblationLadders
from envgs_bench.reports.tables.sections import Section

ROOM = "toy/chrome_room"
PARTS = {
    "2dgs_tuned": "2dgs_tuned",
    "envmap": "+ environment map",
    "envgs_no_joint": "+ environment Gaussians",
    "envgs": "+ joint",
}
GROUND, MAP, NO_JOINT, TOP = PARTS
FRAME_MS = {GROUND: 2.0, MAP: 3.0, NO_JOINT: 6.0, TOP: 7.0}
PRIMITIVES = {GROUND: (1000, 0), MAP: (900, 0), NO_JOINT: (800, 300), TOP: (800, 200)}


@pytest.fixture
def _no_other_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "draw_charts", lambda *_, **__: [])


def write(folder: Path, method: str, seed: int, psnr: float | None, lpips: float | None = 0.1, **changes: Any) -> None:
    """A run of these scores, which did not finish where PSNR is None; `part__name` changes one value of a part."""
    content = record(ROOM, method, seed)
    base, env = PRIMITIVES.get(method, (500, 0))
    content["config"] |= {"method": {"name": method, "settings": changes.pop("settings", {})}}
    if psnr is None:
        content |= {"status": "diverged", "error": {"type": "Diverged", "message": "lost", "log_tail": ""}}
        content |= {"metrics": None, "masked": {}, "timing": None, "cost": None}
    else:
        content["metrics"]["mean"] |= {"psnr": psnr, "lpips": lpips, "flip": 0.2}
        content["masked"] = {"reflective": {"psnr": psnr - 2, "fraction": 0.2, "per_view": []}}
        content["timing"] |= {"frame_ms": FRAME_MS.get(method, 5.0)}
        content["cost"] |= {"primitives": {"base": base, "env": env}, "model_bytes": 1e6, "train_seconds": 20.0}
    for key, value in changes.items():
        part, _, name = key.partition("__")
        if name and content[part] is not None:
            content[part][name] = value
        elif not name:
            content[part] = value
    write_record(folder / f"{method}-{seed}-{len(list(folder.glob('*')))}", content)


def students(differences: Sequence[float]) -> tuple[float, float]:
    found = stats.ttest_1samp(differences, 0).confidence_interval(0.95)
    return float(found.low), float(found.high)


LOST = students((-1.1, -1.0, -0.9))  # of the example's map, dB


def write_all(folder: Path, scores: dict[str, Sequence[float | None]], **changes: Any) -> None:
    for method, psnrs in scores.items():
        for seed, psnr in enumerate(psnrs):
            write(folder, method, seed, psnr, **changes)


def ladders_of(section: Section) -> list[Ladder]:
    study = AblationLadders.of(section)
    return list(study.ladders) if study is not None else []


def ladder_of(folder: Path) -> Ladder:
    (section,) = sections_of(folder)
    (ladder,) = ladders_of(section)
    return ladder


def variant(ladder: Ladder, name: str) -> Variant:
    return next(variant for variant in ladder.variants if variant.name == name)


def verdicts(ladder: Ladder) -> dict[str, str]:
    return {variant.name: ladder.verdict(variant) for variant in ladder.variants}


def taken(ladder: Ladder) -> str | None:
    return ladder.recommended.name if ladder.recommended else None


def test_a_variant_adds_what_it_has_over_the_one_before_on_the_same_seed(tmp_path: Path) -> None:
    """Seeds lie 5 dB apart, variants 1 dB: 20→21, 25→26.2, 30→30.8."""
    write_all(tmp_path, {GROUND: (20.0, 25.0, 30.0), MAP: (21.0, 26.2, 30.8)})
    ladder = ladder_of(tmp_path)
    ground, above = ladder.variants
    added = ladder.difference(above, ladder.before(above), "psnr")
    assert added.strata[0] == pytest.approx((1.0, 1.2, 0.8))
    assert float(added.mean or 0) == pytest.approx(1.0)
    assert added.interval == pytest.approx(students((1.0, 1.2, 0.8)))
    assert ladder.before(ground) is None
    inside = ladder.difference(above, ground, "psnr", "reflective")
    assert inside.strata[0] == pytest.approx((1.0, 1.2, 0.8))


LOW = {GROUND: (20.0, 20.1, 20.2), NO_JOINT: (22.0, 22.1, 22.2), TOP: (24.0, 24.1, 24.2)}
WIDE = (1.1, -0.9, 0.4)  # a mean of 0.2 dB, whose interval holds 0.1


@pytest.mark.parametrize(
    ("scores", "expected", "take"),
    [
        pytest.param(
            LOW | {MAP: (21.0, 21.1, 21.2)},
            {GROUND: "behind", MAP: "behind", NO_JOINT: "behind", TOP: "best"},
            TOP,
            id="the top is the best by far",
        ),
        pytest.param(
            LOW | {MAP: (23.95, 24.03, 24.15)},
            {GROUND: "behind", MAP: "within", NO_JOINT: "behind", TOP: "best"},
            MAP,
            id="a cheaper one loses at most 0.07 dB",
        ),
        pytest.param(
            {GROUND: [24.0 - d for d in WIDE], TOP: (24.0, 24.0, 24.0)},
            {GROUND: "tied", TOP: "best"},
            GROUND,
            id="an interval that holds the tolerance is no proof of a loss",
        ),
        pytest.param(
            {GROUND: (23.865, 23.86, 23.855), TOP: (24.0, 24.0, 24.0)},
            {GROUND: "behind", TOP: "best"},
            TOP,
            id="0.135 to 0.145 dB are more than the tolerance",
        ),
        pytest.param(
            {GROUND: (25.5, 25.6, 25.4), MAP: (25.0, 25.1, 25.0), TOP: (25.0, 25.0, 24.9)},
            {GROUND: "best", MAP: "behind", TOP: "behind"},
            GROUND,
            id="nothing reflects",
        ),
        pytest.param(
            {GROUND: (24.0, None, 24.0), MAP: (20.0, 20.0, 20.0), TOP: (24.0, 24.0, 24.0)},
            {GROUND: "failed", MAP: "behind", TOP: "best"},
            TOP,
            id="what failed is not taken, whatever it would save",
        ),
        pytest.param(
            {GROUND: (26.0, 26.0, 26.0, None), MAP: [20.0] * 4, TOP: [24.0] * 4},
            {GROUND: "failed", MAP: "behind", TOP: "best"},
            TOP,
            id="what failed once is not the best either",
        ),
        pytest.param(
            {GROUND: (24.0, 24.0), MAP: (20.0, 20.0), TOP: (24.0, 24.0)},
            {GROUND: "undecided", MAP: "undecided", TOP: "undecided"},
            None,
            id="two seeds",
        ),
        pytest.param(
            {GROUND: (24.0, 24.0), MAP: (20.0, 20.0, 20.0), TOP: (24.0, 24.0, 24.0)},
            {GROUND: "undecided", MAP: "behind", TOP: "best"},
            TOP,
            id="two seeds of the cheapest",
        ),
        pytest.param(
            {GROUND: (None, None, None), TOP: (24.0, 24.0, 24.0)},
            {GROUND: "failed", TOP: "best"},
            None,
            id="nothing is left to compare with",
        ),
    ],
)  # fmt: skip
def test_the_cheapest_variant_that_is_not_shown_to_be_worse_is_taken(
    tmp_path: Path, scores: dict[str, Sequence[float | None]], expected: dict[str, str], take: str | None
) -> None:
    write_all(tmp_path, scores)
    ladder = ladder_of(tmp_path)
    assert verdicts(ladder) == expected
    assert taken(ladder) == take
    assert recommendation(ladder).method == (take or "")


def test_psnr_alone_takes_no_variant(tmp_path: Path) -> None:
    """LPIPS 0.100 at the top; a variant as good by PSNR is not taken at 0.107 and is at 0.104."""
    for seed in range(3):
        write(tmp_path, GROUND, seed, 24.0, 0.107)
        write(tmp_path, MAP, seed, 24.0, 0.104)
        write(tmp_path, TOP, seed, 24.05, 0.1)
    ladder = ladder_of(tmp_path)
    assert verdicts(ladder) == {GROUND: "behind", MAP: "within", TOP: "best"}
    assert taken(ladder) == MAP


def test_a_variant_that_is_better_by_lpips_is_told(tmp_path: Path) -> None:
    for seed in range(3):
        write(tmp_path, GROUND, seed, 24.0, 0.12)
        write(tmp_path, MAP, seed, 24.6, 0.102)
        write(tmp_path, TOP, seed, 25.0, 0.112)
    ladder = ladder_of(tmp_path)
    assert taken(ladder) == TOP
    assert f"With {MAP}, better by LPIPS: −0.40 dB [−0.40, −0.40], LPIPS −0.010" in recommendation(ladder).text


@pytest.mark.parametrize("flip", [0.2, None])
def test_without_lpips_flip_stands_in_and_without_both_the_sentence_says_so(tmp_path: Path, flip: float | None) -> None:
    for seed in range(3):
        write(tmp_path, GROUND, seed, 24.0, lpips=None if seed else 0.1)
        write(tmp_path, MAP, seed, 24.0, lpips=None)
        write(tmp_path, TOP, seed, 24.05, lpips=None)
    for path in tmp_path.glob("*/record.json"):
        content = json.loads(path.read_text())
        content["metrics"]["mean"]["flip"] = flip and flip + 0.006 * (content["method"] == GROUND)
        path.write_text(json.dumps(content))
    ladder = ladder_of(tmp_path)
    assert taken(ladder) == (MAP if flip else GROUND)
    judged = "PSNR and FLIP" if flip else "PSNR"
    assert f"LPIPS was not computed of every run: judged by {judged}." in recommendation(ladder).text


@pytest.mark.parametrize(("second", "expected"), [(2.09, MAP), (2.11, GROUND)])
def test_equal_frame_times_are_told_apart_by_primitives(tmp_path: Path, second: float, expected: str) -> None:
    """Both within the tolerance; 5 % of the fastest 2 ms are 2.1 ms, and the map has 900 primitives, 2DGS 1,000."""
    for seed in range(3):
        write(tmp_path, GROUND, seed, 24.0)
        write(tmp_path, MAP, seed, 24.0, timing__frame_ms=second)
        write(tmp_path, TOP, seed, 24.05)
    assert taken(ladder_of(tmp_path)) == expected


def test_without_seeds_in_common_there_is_no_verdict(tmp_path: Path) -> None:
    for seed in range(3):
        write(tmp_path, GROUND, seed, 20.0)
        write(tmp_path, TOP, seed + 1, 24.0)
    ladder = ladder_of(tmp_path)
    assert taken(ladder) is None
    assert recommendation(ladder).text == (
        f"On {ROOM} no verdict ({GROUND}: 2 seeds in common with {TOP}): a verdict needs two variants that finished "
        "with the same 3 seeds."
    )


def test_the_variant_before_is_the_next_that_finished(tmp_path: Path) -> None:
    write_all(tmp_path, {GROUND: (20.0, 20.0, 20.0), MAP: (None, None, None), TOP: (24.0, 24.5, 23.5)})
    ladder = ladder_of(tmp_path)
    before = ladder.before(variant(ladder, TOP))
    assert before is not None
    assert before.name == GROUND
    assert recommendation(ladder).text.endswith(f"Left out: {MAP}: 3 of 3 runs did not finish.")


def test_variants_of_other_lengths_make_ladders_of_their_own(tmp_path: Path) -> None:
    for seed in range(3):
        for method, psnr in ((GROUND, 20.0), (TOP, 24.0)):
            write(tmp_path, method, seed, psnr, steps=100)
            write(tmp_path, method, seed, psnr + 1, steps=900)
        write(tmp_path, MAP, seed, 23.0, steps=900)
    (section,) = sections_of(tmp_path)
    short, long = ladders_of(section)
    assert [ladder.title for ladder in ladders_of(section)] == [f"{ROOM} [steps=100]", f"{ROOM} [steps=900]"]
    assert [variant.method for variant in short.variants] == [f"{GROUND} [steps=100]", f"{TOP} [steps=100]"]
    assert [variant.method for variant in long.variants] == [f"{GROUND} [steps=900]", MAP, f"{TOP} [steps=900]"]


def test_lengths_that_no_two_variants_share_make_no_ladder(tmp_path: Path) -> None:
    write(tmp_path, GROUND, 0, 20.0, steps=100)
    write(tmp_path, TOP, 0, 24.0, steps=900)
    (section,) = sections_of(tmp_path)
    assert ladders_of(section) == []


def test_a_swept_setting_of_several_variants_sets_ladders_apart_and_one_variants_own_does_not(tmp_path: Path) -> None:
    for seed in range(3):
        for cap in (5, 10):
            write(tmp_path, GROUND, seed, 20.0 + cap, settings={"cap": cap})
            for share in (0.0, 0.5)[: 2 - (seed == 2)]:
                write(tmp_path, TOP, seed, 24.0 + cap, settings={"cap": cap, "beta_filter": share})
        write(tmp_path, MAP, seed, 22.0)
    (section,) = sections_of(tmp_path)
    assert [ladder.settings for ladder in ladders_of(section)] == ["cap=5", "cap=10"]
    for cap, ladder in zip((5, 10), ladders_of(section), strict=True):
        methods = [f"{GROUND} [cap={cap}]", MAP, f"{TOP} [beta_filter=0.0, cap={cap}]"]
        assert [variant.method for variant in ladder.variants] == methods
        assert ladder.passed_over == (f"{TOP} [beta_filter=0.5, cap={cap}]",)


def test_perturbed_runs_are_no_variants(tmp_path: Path) -> None:
    perturbation = {"kind": "blur", "severity": 1, "level": "soft"}
    write_all(tmp_path, {GROUND: (20.0,)})
    write_all(tmp_path, {TOP: (24.0,)}, perturbation=perturbation)
    (section,) = sections_of(tmp_path)
    assert ladders_of(section) == []


def write_example(folder: Path) -> None:
    """Nothing reflects: the map loses 1 dB, environment Gaussians win back 0.25, joint optimization 0.25 more."""
    for seed, wobble in enumerate((-0.1, 0.0, 0.1)):
        write(folder, GROUND, seed, 25.0, 0.04, cost__model_bytes=3_140_000)
        write(folder, MAP, seed, 24.0 + wobble, 0.06)
        write(folder, NO_JOINT, seed, 24.25 + wobble, 0.055)
        write(folder, TOP, seed, 24.5 + wobble, 0.05)


def test_the_sentence_says_what_to_take_what_it_costs_and_what_the_top_would_change(tmp_path: Path) -> None:
    write_example(tmp_path)
    assert recommendation(ladder_of(tmp_path)).text == (
        f"On {ROOM} take {GROUND}: 1,000 primitives, 2.00 ms a frame, 3.1 MB, 20 s of training. With {TOP}, the top of "
        "the ladder: −0.50 dB [−0.75, −0.25], LPIPS +0.010 [+0.010, +0.010], 7.00 ms a frame."
    )


@pytest.mark.usefixtures("_no_other_charts")
def test_the_page_the_tables_and_the_csv_hold_the_same_numbers(tmp_path: Path) -> None:
    write_example(tmp_path / "runs")
    made = report.build_report(tmp_path / "runs", tmp_path / "out", for_print=True)
    with (made.out / "ablation-ladder.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    found = {(row["method"], row["region"], row["quantity"], row["against"]): row for row in rows}
    added = found[MAP, "reflective", "psnr", GROUND]
    assert [float(added[key]) for key in ("value", "low", "high", "std")] == pytest.approx([-1.0, *LOST, 0.1])
    assert (added["step"], added["runs"], added["settings"]) == ("2", "3", "")
    assert float(found[NO_JOINT, "full", "psnr", MAP]["value"]) == pytest.approx(0.25)
    assert float(found[TOP, "full", "lpips", GROUND]["value"]) == pytest.approx(0.01)
    assert float(found[GROUND, "full", "model_bytes", ""]["value"]) == 3_140_000
    assert float(found[TOP, "full", "primitives_env", ""]["value"]) == 200
    assert not [row for row in rows if "nan" in row.values()]
    with (made.out / "ablation-ladder-summary.csv").open(newline="") as stream:
        (summary,) = csv.DictReader(stream)
    sentence = recommendation(ladder_of(tmp_path / "runs")).text
    assert (summary["take"], summary["best"], summary["sentence"]) == (GROUND, GROUND, sentence)
    html, markdown = made.page.read_text(), (made.out / "table.md").read_text()
    headline = recommendation(ladder_of(tmp_path / "runs")).headline
    assert headline in html
    assert sentence in markdown
    for text in (html, markdown):
        assert "−1.00 [−1.25, −0.75]" in text
        assert "+0.25 [+0.25, +0.25]" in text
    assert f"| **{GROUND}** | 3/3 |" in markdown
    assert f"Variants: {GROUND} (2dgs_tuned): take: best PSNR; {MAP} (+ environment map): behind the best; " in markdown
    assert r"\best{2dgs\_tuned} & 3/3 &" in (made.out / "table.tex").read_text()
    tables = json.loads((made.out / "table.json").read_text())["sections"][0]["tables"]
    (table,) = [table for table in tables if table["kind"] == "ablation-ladder"]
    cell = table["rows"][1]["cells"]["whole picture: psnr - the variant before"]
    assert cell["interval"] == pytest.approx(LOST)
    assert [row["taken"] for row in table["rows"]] == [True, False, False, False]
    assert 'id="section-0-ablation-ladder"' in html


def variants_on(page: str) -> list[list[str]]:
    """The text of each cell of the page's ladder, row by row."""
    (table,) = re.findall(r'<table class="variants">.*?<tbody>(.*?)</tbody>', page, re.DOTALL)
    rows = [re.findall(r"<t[hd].*?</t[hd]>", row, re.DOTALL) for row in table.split("<tr")[1:]]
    return [[" ".join(unescape(re.sub(r"<[^>]*>", " ", cell)).split()) for cell in row] for row in rows]


@pytest.mark.usefixtures("_no_other_charts")
def test_the_page_prints_every_number_of_the_table(tmp_path: Path) -> None:
    write_example(tmp_path / "runs")
    made = report.build_report(tmp_path / "runs", tmp_path / "out")
    table = titled(made.sections[0], f"{ROOM}: ablation ladder")
    expected = [
        [
            f"{row.method} {PARTS[row.method]} {row.verdict}",
            row.runs_text,
            *(
                " ".join(row.cells[column.key].text for column in columns)
                for _, columns in groupby(table.columns, key=lambda column: column.group or column.key)
            ),
        ]
        for row in table.rows
    ]
    assert variants_on(made.page.read_text()) == expected


def test_the_chart_goes_up_from_the_baseline_by_what_each_variant_adds(tmp_path: Path) -> None:
    write_example(tmp_path)
    ladder = ladder_of(tmp_path)
    found = steps(ladder)
    assert [step.variant.name for step in found] == list(PARTS)
    assert [step.level for step in found] == pytest.approx([0, -1, -0.75, -0.5])
    assert [step.frame_ms for step in found] == [2.0, 3.0, 6.0, 7.0]
    assert found[1].interval == pytest.approx(LOST)
    (chart,) = draw_ladders([ladder], styles(list(PARTS), {}), Canvas(tmp_path, pdf=True), "charts/ladder-0")
    for name in (chart.png, chart.pdf or ""):
        assert (tmp_path / name).stat().st_size > 1000


def test_a_table_has_a_row_a_variant_and_the_regions_that_there_are(tmp_path: Path) -> None:
    write_example(tmp_path)
    (section,) = sections_of(tmp_path)
    table = titled(section, f"{ROOM}: ablation ladder")
    assert [row.method for row in table.rows] == list(PARTS)
    groups = list(dict.fromkeys(column.group for column in table.columns if column.group))
    assert groups == ["whole picture", "reflective", "against the best", "primitives"]
    assert row_of(table, MAP).cells["against the best: psnr - the best"].text == "−1.00 [−1.25, −0.75]"
    assert row_of(table, GROUND).cells["against the best: psnr - the best"].text == "—"
    assert row_of(table, TOP).cells["primitives: primitives_env"].text == "200"


def test_one_variant_is_no_ladder(tmp_path: Path) -> None:
    write_all(tmp_path, {"3dgs": (20.0, 20.0, 20.0), TOP: (24.0, 24.0, 24.0)})
    (section,) = sections_of(tmp_path)
    assert ladders_of(section) == []
    assert not [table for table in tables_of(section) if table.kind == AblationLadders.name]
    assert draw_ladders([], {}, Canvas(tmp_path), "charts/ladder-0") == []


HOSTILE = """=1+1</script><script>window.hacked=1</script>'"|&\\$_{}\x1b[31m"""


@pytest.mark.usefixtures("_no_other_charts")
@pytest.mark.filterwarnings("ignore:Glyph")  # that charts' font has no control characters
def test_what_records_say_stays_text(tmp_path: Path) -> None:
    for seed in range(3):
        for method in (GROUND, TOP):
            for steps_ in (100, 900):
                settings = {HOSTILE: steps_}
                write(tmp_path / "runs", method, seed, 20.0, dataset=HOSTILE, settings=settings)
    made = report.build_report(tmp_path / "runs", tmp_path / "out")
    html = made.page.read_text()
    assert len(ladders_of(made.sections[0])) == 2
    assert "<script>" not in html
    assert "take: best PSNR" in html
    for name in ("ablation-ladder.csv", "ablation-ladder-summary.csv"):
        with (made.out / name).open(newline="") as stream:
            cells = [cell for row in csv.reader(stream) for cell in row]
        assert not [cell for cell in cells if cell.startswith(("=", "@")) or not cell.isprintable()]
