"""Populations in reports: standings, failure map and what is enough, from made-up records whose answer is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from reports_runs import record, sections_of, write_record
from scipy.stats import binomtest, bootstrap

from envgs_bench.cli.main import main
from envgs_bench.reports import build_report
from envgs_bench.reports.documentation import fill_page
from envgs_bench.reports.numbers.intervals import sample_interval, share_interval
from envgs_bench.reports.studies.population.attribute_words import condition
from envgs_bench.reports.studies.population.failure_map import Question, failure_map, sentences, signs_told
from envgs_bench.reports.studies.population.goals import goals, told
from envgs_bench.reports.studies.population.sentences import shown, worth
from envgs_bench.reports.studies.population.study import PopulationStudy

MIRRORS = 0.2  # from which share of mirrors on envgs is ahead, by 2 dB; below it loses by 0.5


def write_scenes(folder: Path, count: int = 40, failed: int | None = None) -> None:
    """Scenes of seeds from 12 on: 20 are for choosing. What mirrors decides who is ahead, other attributes do not."""
    random = np.random.default_rng(0)
    for seed in range(12, 12 + count):
        mirrors, level = random.uniform(0, 0.5), random.uniform(20, 30)
        attributes = {
            "mirror": mirrors,
            "reflective": mirrors + 0.05,
            "texture": random.uniform(),
            "sky": random.uniform(),
        }
        ahead = 2.0 if mirrors >= MIRRORS else -0.5
        values = {"2dgs_tuned": level, "envmap": level - 1.0, "envgs": level + ahead, "3dgs": level - 3.0}
        for method, psnr in values.items():
            content = record(f"sampled/{seed}", method, 0, attributes=attributes)
            content["config"]["dataset"] = {"kind": "sampled", "seed": seed}
            content["metrics"]["mean"] |= {"psnr": psnr}
            if seed == failed and method == "3dgs":
                content |= {"status": "diverged", "error": {"type": "Diverged", "message": "lost", "log_tail": ""}}
                content |= {"metrics": None, "masked": {}, "timing": None, "cost": None}
            write_record(folder / f"{method}-{seed}", content)


def study_of(folder: Path) -> PopulationStudy:
    (section,) = sections_of(folder)
    study = PopulationStudy.of(section)
    assert study is not None
    return study


def test_standings_are_those_that_were_put_in(tmp_path: Path) -> None:
    write_scenes(tmp_path, failed=20)
    found = study_of(tmp_path).found
    ahead = (found.attributes.loc[found.psnr.index, "mirror"] >= MIRRORS).to_numpy()
    ours, theirs = found.standing("envgs"), found.standing("2dgs_tuned")
    assert ours.scenes == theirs.scenes == 39
    assert (ours.best, theirs.best) == (ahead.sum(), (~ahead).sum())
    assert ours.margin == pytest.approx(2.0 * ahead.mean() - 0.5 * (1 - ahead.mean()))
    assert ours.margin_interval is not None
    assert ours.margin_interval[0] < ours.margin < ours.margin_interval[1]
    assert ours.level == pytest.approx(ahead.mean())
    assert ours.worst == pytest.approx(-0.5)
    assert (found.standing("3dgs").failed, ours.failed) == (1, 0)
    assert (len(found.scenes("choosing")), len(found.scenes("judging"))) == (19, 20)


def test_the_gap_is_what_choosing_flattered(tmp_path: Path) -> None:
    write_scenes(tmp_path)
    found = study_of(tmp_path).found
    gap = found.gap("envgs")
    assert gap is not None
    assert gap[0] == pytest.approx(found.margins("envgs", "choosing").mean() - found.margins("envgs", "judging").mean())


def test_the_map_asks_what_decides_and_holds_on_unseen_scenes(tmp_path: Path) -> None:
    write_scenes(tmp_path)
    study = study_of(tmp_path)
    assert study.found.subject == "envgs"  # the top of its ladder
    tree = study.mapped.tree
    assert isinstance(tree, Question)
    assert tree.attribute == "mirror"
    assert tree.below == pytest.approx(MIRRORS, abs=0.03)
    assert study.mapped.signs >= 0.9
    assert study.mapped.ranks.index[0] == "mirror"
    said = list(sentences(tree, "envgs", "the best other method", 0.1))
    least = f"{100 * tree.below:.2g} % of the pixels mirror"
    assert any(line.startswith(f"Where less than {least}: envgs loses to the best other") for line in said)
    assert any(line.startswith(f"Where at least {least}: envgs beats the best other method by 2.0") for line in said)


def test_the_map_finds_nothing_where_there_is_nothing() -> None:
    random = np.random.default_rng(3)
    attributes = pd.DataFrame(random.uniform(size=(60, 5)), columns=list("abcde"))
    mapped = failure_map(attributes, pd.Series(random.normal(size=60)))
    assert mapped.explained < 0.1
    assert mapped.signs < 0.7


def test_what_is_enough_is_the_first_of_the_ladder_and_the_smallest(tmp_path: Path) -> None:
    write_scenes(tmp_path)
    found = study_of(tmp_path).found
    assert found.ladder == ("2dgs_tuned", "envmap", "envgs")
    for scene in found.psnr.index:
        mirrors = found.attributes.loc[scene, "mirror"] >= MIRRORS
        assert found.enough(scene)[0] == ("envgs" if mirrors else "2dgs_tuned")


def test_intervals_are_scipys() -> None:
    for hits, count in ((0, 12), (5, 64), (64, 64)):
        theirs = binomtest(hits, count).proportion_ci(0.95)
        assert share_interval(hits, count) == pytest.approx((theirs.low, theirs.high))
    values = np.random.default_rng(1).exponential(size=64)
    theirs = bootstrap((values,), np.mean, method="percentile", rng=np.random.default_rng(2)).confidence_interval
    assert sample_interval(values) == pytest.approx((theirs.low, theirs.high), abs=0.02)
    half = 1.96 * np.sqrt(2) * values.std(ddof=1) / 8  # of a normal difference of two means
    assert sample_interval(values, values + 1.0) == pytest.approx((-1 - half, -1 + half), abs=0.1 * half)


def test_few_scenes_or_scenes_without_attributes_are_no_population(tmp_path: Path) -> None:
    write_scenes(tmp_path / "few", count=7)
    (section,) = sections_of(tmp_path / "few")
    assert PopulationStudy.of(section) is None


def test_the_page_shows_the_population(tmp_path: Path) -> None:
    write_scenes(tmp_path / "runs")
    build_report(tmp_path / "runs", tmp_path / "out")
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "Population of scenes" in page
    assert "envgs beats the best other method by 2.0 dB" in page
    assert "of the pixels mirror: envgs beats 2dgs_tuned by 2.0 dB" in page
    assert "Missed: envgs is level with every other method, or ahead, on" in page
    table = pd.read_csv(tmp_path / "out" / "population.csv")
    assert len(table) == 40
    assert {"part", "mirror", "psnr: envgs", "margin: envgs"} <= set(table.columns)
    assert (tmp_path / "out" / "charts" / "population-0" / "failure-map.png").is_file()


def test_pages_say_the_same_of_kept_runs(tmp_path: Path) -> None:
    write_scenes(tmp_path / "runs", failed=20)
    assert main(["report", str(tmp_path / "runs"), "--keep", str(tmp_path / "records" / "runs.csv")]) == 0
    asked = ("goals of=envgs", "standings of=envgs", "failure_map of=envgs", "needs of=envgs ladder=2dgs_tuned,envgs")
    comments = "".join(f"<!-- table: {one} records=runs.csv -->\n<!-- end of table -->\n" for one in asked)
    (tmp_path / "page.md").write_text(comments, encoding="utf-8")
    text, absent = fill_page(tmp_path / "page.md", tmp_path / "records")
    assert absent == []
    study = study_of(tmp_path / "runs")
    ours = shown(study.found.standing("envgs", "judging"))
    assert f"| envgs | {ours['best']} | {ours['margin']} |" in text
    assert "| less than 20 % of the pixels mirror | -0.5 | 14 |" in text  # as `write_scenes` made them
    for sentence in (*worth(study.found, study.mapped), *told(goals(study.found, study.mapped))):
        assert f"* {sentence}\n" in text
    assert text.index("Missed: ") < text.index("Reached: ")
    assert "primitives that are enough" in text


def test_a_page_of_too_few_scenes_says_so(tmp_path: Path) -> None:
    write_scenes(tmp_path / "runs", count=5)
    main(["report", str(tmp_path / "runs"), "--keep", str(tmp_path / "records" / "runs.csv")])
    page = tmp_path / "page.md"
    page.write_text("<!-- table: goals of=envgs records=runs.csv -->\n<!-- end of table -->\n", encoding="utf-8")
    text, absent = fill_page(page, tmp_path / "records")
    assert "*Not measured: records/runs.csv has fewer than 8 scenes" in text
    assert len(absent) == 1


def test_what_is_missed_is_what_the_numbers_say(tmp_path: Path) -> None:
    """Of scenes whose differences are set: it is behind by 0.5 dB or ahead by 2, and no run failed."""
    write_scenes(tmp_path)
    study = study_of(tmp_path)
    judged = study.found.margins("envgs", "judging")
    reached = [goal.reached for goal in goals(study.found, study.mapped)]
    reflects = study.found.attributes.loc[judged.index, "reflective"] >= 0.1
    assert reached == [(judged > 0).mean() >= 0.9, judged[reflects].mean() >= 1.0, False, True, True]


def test_a_tree_grown_on_some_scenes_is_held_against_others() -> None:
    random = np.random.default_rng(5)
    attributes = pd.DataFrame(random.uniform(size=(60, 3)), columns=list("abc"))
    difference = pd.Series(np.where(attributes["b"] < 0.4, -1.0, 1.0))
    grown = failure_map(attributes[:30], difference[:30])
    assert signs_told(grown, attributes[30:], difference[30:]) >= 0.9
    assert signs_told(grown, attributes[30:], -difference[30:]) <= 0.1


@pytest.mark.parametrize(
    ("attribute", "below", "words"),
    [
        ("mirror", True, "less than 2 % of the pixels mirror"),
        ("mirrored_distance", False, "what is mirrored is as far as 0.02 m"),
        ("grain", True, "grain is below 0.02"),
    ],
)
def test_conditions_are_words(attribute: str, below: bool, words: str) -> None:
    assert condition(attribute, 0.02, below) == words
