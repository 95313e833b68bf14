"""Published methods beside their authors' code: what is faithful, and the page's tables from the marks of both."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import pandas as pd
import pytest

from envgs_bench.cli.composition import config_names
from envgs_bench.methods.registry import BUILT_IN
from envgs_bench.reports.documentation import fill_page
from envgs_bench.reports.kept import originals
from envgs_bench.reports.kept.csv_file import NoRunsError
from envgs_bench.reports.kept.kept_runs import TableError

DOCS = Path(__file__).parents[2] / "envgs_bench" / "docs"
RECORDS = DOCS / "records"
OURS_ALONE = {"envgs", "envgs_single_set", "envmap"}  # kinds without a published method of that name


def marks(*rows: tuple[str, int, int, float, int]) -> pd.DataFrame:
    """Program, seed, steps, PSNR and primitives of each mark of one method on one scene."""
    names = ("program", "seed", "steps", "psnr", "primitives")
    shared = {"method": "2dgs", "scene": "toy/glass", "commit": "abc", "run": 1, "seconds": 8.0}
    shared |= {"device": "X"} | dict.fromkeys(originals.ALONE)
    return pd.DataFrame([shared | dict(zip(names, row, strict=True)) for row in rows])


def only(found: pd.DataFrame) -> originals.Pair:
    (pair,) = originals.pairs_of(found)
    return pair


WORDS = pd.DataFrame(
    [("2dgs", "a/b", "abc", "2dgs.md", "depth"), ("3dgs", "c/d", "def", "3dgs.md", "")], columns=list(originals.WORDS)
)


def test_a_scene_is_compared_at_the_last_step_that_both_reached() -> None:
    pair = only(
        marks(("original", 0, 1000, 20.0, 50), ("original", 0, 3000, 22.0, 100), ("original", 0, 5000, 23.0, 100))
        .pipe(lambda theirs: pd.concat([theirs, marks(("ours", 0, 3000, 22.25, 105), ("ours", 0, 7000, 24.0, 1))]))
    )  # fmt: skip
    assert (pair.steps, pair.gain, pair.apart) == (3000, 0.25, [])
    assert pair.share == pytest.approx(0.05)


@pytest.mark.parametrize(("gain", "share"), [*itertools.product((-0.4, -0.29, 0.2, 0.31), (-0.12, 0.0, 0.09, 0.5))])
def test_scores_and_primitives_are_bounded_each(gain: float, share: float) -> None:
    pair = only(marks(("original", 0, 9, 24.0, 1000), ("ours", 0, 9, 24.0 + gain, round(1000 * (1 + share)))))
    expected = [name for name, far in (("dB", abs(gain) > 0.3), ("primitives", abs(share) > 0.1)) if far]
    assert pair.apart == expected


def test_an_originals_own_spread_is_allowed_where_it_is_larger() -> None:
    apart = (("original", 0, 9, 24.0, 1000), ("original", 1, 9, 25.0, 1300))
    assert only(marks(*apart, ("ours", 0, 9, 23.6, 950))).apart == []
    assert only(marks(*apart, ("ours", 0, 9, 23.4, 850))).apart == ["dB", "primitives"]


def test_seeds_are_averaged() -> None:
    pair = only(marks(("original", 0, 9, 24.0, 100), ("ours", 0, 9, 23.0, 90), ("ours", 1, 9, 25.0, 110)))
    assert (pair.gain, pair.share) == (0.0, 0.0)
    shown = originals.comparisons(pd.concat([pair.original, pair.ours]), WORDS)
    assert "| so far | 24.00 | 24.00 ± 1.41 | 100 | 100 | 8 | 8 |" in shown
    shown = originals.comparisons(pd.concat([pair.original.assign(seconds=math.nan), pair.ours]), WORDS)
    assert "| 100 | 100 | – | 8 |" in shown


def test_a_method_without_marks_is_said_not_to_have_been_run() -> None:
    found = marks(("original", 0, 9, 24.0, 100), ("ours", 0, 9, 23.0, 90))
    first, second = originals.verdicts(found, WORDS).splitlines()[2:]
    assert first.split(" | ")[2:] == ["1", "9", "no", "−1.00 dB, −10% |"]
    assert "| 0 | – | not run | – |" in second
    assert originals.what_differs(found, WORDS).splitlines()[2:] == [f"| {first.split(' | ')[0].strip('| ')} | depth |"]


@pytest.mark.parametrize(("steps", "verdict"), [(6_999, "so far"), (7_000, "yes")])
def test_agreement_is_no_verdict_before_enough_steps(steps: int, verdict: str) -> None:
    found = marks(("original", 0, steps, 24.0, 100), ("ours", 0, steps, 24.1, 100))
    assert f"| {steps:,} | {verdict} | 24.00 | 24.10 |" in originals.comparisons(found, WORDS)
    assert f"| 1 | {steps:,} | {verdict} | +0.10 dB, +0% |" in originals.verdicts(found, WORDS)
    apart = found.assign(scene="toy/glass_2", psnr=[24.0, 20.0])
    assert f"| 2 | {steps:,} | on 1 | −4.00 dB, +0% |" in originals.verdicts(pd.concat([found, apart]), WORDS)


def test_what_was_timed_alone_is_the_last_that_both_have() -> None:
    found = marks(("original", 0, 9, 24.0, 100), ("ours", 0, 9, 24.0, 90), ("original", 0, 99, 24.0, 100))
    with pytest.raises(NoRunsError):
        originals.costs_alone(found, WORDS)
    found[["step_ms", "frame_ms"]] = [(8.0, 4.0), (2.0, 0.5), (9.0, 9.0)]
    assert "| 9 | 100 | 90 | 8.00 | 2.00 | 4.0× | 4.00 | 0.50 | 8.0× |" in originals.costs_alone(found, WORDS)


def test_files_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    page, comment = tmp_path / "page.md", "<!-- table: verdicts records=marks.csv words=words.csv -->"
    page.write_text(f"{comment}\n<!-- end of table -->\n", encoding="utf-8")
    with pytest.raises(TableError, match=r"marks.csv: cannot be read"):
        fill_page(page, tmp_path)
    (tmp_path / "marks.csv").write_text("method,scene\n", encoding="utf-8")
    with pytest.raises(TableError, match=r"marks.csv.*it has no program"):
        fill_page(page, tmp_path)
    page.write_text(f"{comment.replace(' words=words.csv', '')}\n<!-- end of table -->\n", encoding="utf-8")
    with pytest.raises(TableError, match="say records=<file>"):
        fill_page(page, tmp_path)


def test_every_published_method_has_a_row() -> None:
    """The kinds that are built here after others' papers, and the variants of theirs that are no tuning of ours."""
    named = set(originals.read_words(RECORDS / "originals_methods.csv")["method"])
    assert named == (set(BUILT_IN) - OURS_ALONE) | {"ref_dgs", "envgs_released"}
    assert named <= {*BUILT_IN, *config_names("method")}


def test_the_kept_marks_are_whole() -> None:
    kept = originals.read_marks(RECORDS / "originals.csv")
    assert not kept.duplicated(["method", "scene", "program", "seed", "run", "steps"]).any()
    assert set(kept["program"]) == {originals.ORIGINAL, originals.OURS}
    for (_, scene, *_), run in kept.groupby(["method", "scene", "program", "seed", "run"]):
        assert run["steps"].is_monotonic_increasing, scene
        assert run["seconds"].dropna().is_monotonic_increasing, scene
