"""report --against: what left the band of its seeds is listed, worse first, and the exit status says so."""

from __future__ import annotations

import json
import re
import shutil
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from reports_runs import write_failure, write_runs
from scipy import stats

from envgs_bench.cli.main import main
from envgs_bench.reports.kept.against import against, as_markdown
from envgs_bench.reports.kept.runs_file import RunsFileError, read_kept
from envgs_bench.reports.numbers.runs import read_runs

ROOT = Path(__file__).parents[2]
SCENE = "toy/chrome_room"


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A folder of runs of one scene, four methods and three seeds."""
    write_runs(tmp_path / "old", (SCENE,), pictures=False)
    return tmp_path / "old"


def changed(old: Path, by: float, method: str = "envgs", metric: str = "psnr", seeds: tuple[int, ...] = ()) -> Path:
    """The same runs, one score of one method moved; of these seeds alone, where given."""
    new = old.parent / "new"
    shutil.copytree(old, new)
    for path in list(new.rglob("record.json")):
        record = json.loads(path.read_text())
        if seeds and record["seed"] not in seeds:
            shutil.rmtree(path.parent)
            continue
        if record["method"] == method:
            record["metrics"]["mean"][metric] += by
        path.write_text(json.dumps(record))
    return new


def values(folder: Path, method: str) -> np.ndarray:
    runs = read_runs(folder)[0]
    return np.array([run.record.metrics.mean["psnr"] for run in runs if run.record.method == method and run.ok])  # type: ignore[union-attr]


def test_the_same_runs_left_no_band(old: Path) -> None:
    found = against(read_runs(old)[0], old)
    assert found.compared > 20
    assert (found.changes, found.missing, found.got_worse) == ([], [], False)


@pytest.mark.parametrize("by", [-5.0, 5.0])
def test_a_change_beyond_the_band_has_its_direction(old: Path, by: float) -> None:
    new = changed(old, by)
    (change,) = against(read_runs(new)[0], old).changes
    assert (change.cell[:2], change.column.metric if change.column else "") == ((SCENE, "envgs"), "psnr")
    assert change.direction == ("worse" if by < 0 else "better")
    assert change.now - change.before == pytest.approx(by, abs=1e-3)
    before, now = values(old, "envgs"), values(new, "envgs")
    low, high = stats.ttest_ind(now, before, equal_var=False).confidence_interval()  # Welch's, of the difference
    assert change.band == pytest.approx((high - low) / 2, rel=1e-3)


def test_a_change_within_the_band_is_none(old: Path) -> None:
    spread = values(old, "envgs").std(ddof=1)
    assert not against(read_runs(changed(old, -0.5 * spread))[0], old).changes


def test_lower_is_better_where_the_metric_says_so(old: Path) -> None:
    (change,) = against(read_runs(changed(old, 0.5, metric="flip"))[0], old).changes
    assert change.direction == "worse"


def test_single_runs_are_compared_to_the_printed_decimal(old: Path) -> None:
    only = changed(old, 0.0, seeds=(0,))
    shutil.rmtree(old)
    shutil.copytree(only, old)
    shutil.rmtree(only)
    assert not against(read_runs(changed(old, 0.004))[0], old).changes
    shutil.rmtree(only)
    assert against(read_runs(changed(old, -0.006))[0], old).got_worse


def test_a_single_run_is_held_against_the_spread_of_the_others(old: Path) -> None:
    spread = values(old, "envgs").std(ddof=1)
    assert not against(read_runs(changed(old, -0.2 * spread, seeds=(0,)))[0], old).changes
    shutil.rmtree(old.parent / "new")
    assert against(read_runs(changed(old, -100 * spread, seeds=(0,)))[0], old).got_worse


def test_runs_that_fail_and_did_not_are_worse_and_cells_that_were_not_run_are_named(old: Path) -> None:
    new = changed(old, 0.0)
    write_failure(new, SCENE, "envgs", 7, "diverged", "loss is nan")
    for folder in list(new.rglob("2dgs")):
        shutil.rmtree(folder)
    found = against(read_runs(new)[0], old)
    (change,) = found.changes
    assert (change.column, change.direction, change.now) == (None, "worse", 0.75)
    assert [cell[1] for cell in found.missing] == ["2dgs"]
    assert "Not run: toy/chrome_room 2dgs." in as_markdown(found, old)


def test_the_command_lists_it_first_and_says_so(old: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new = changed(old, -5.0)
    out = str(old.parent / "report")
    assert main(["report", str(old), "--keep", str(old.parent / "old.csv")]) == 0
    capsys.readouterr()
    assert main(["report", str(new), "--out", out, "--against", str(old.parent / "old.csv")]) == 1
    printed = capsys.readouterr().out
    places = [printed.index("worse"), printed.index("left the band"), printed.rindex(str(old.parent / "report"))]
    assert places == sorted(places)
    assert "| worse | toy/chrome_room | envgs | PSNR |" in (old.parent / "report" / "against.md").read_text()
    assert main(["report", str(old), "--out", out, "--against", str(old.parent / "old.csv")]) == 0


def test_what_is_no_earlier_report_is_named(old: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(RunsFileError, match="holds no run to compare with"):
        against(read_runs(old)[0], tmp_path / "empty")
    (tmp_path / "a.csv").write_text("a,b\n1,2\n")
    with pytest.raises(RunsFileError, match="expected a CSV of kept runs"):
        against(read_runs(old)[0], tmp_path / "a.csv")


def test_what_the_workflow_holds_runs_against_can_be_read() -> None:
    """And has every run of the command above it."""
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").partition("\npublished:")[2].partition("\n\n")[0]
    (path,) = re.findall(r"--against (\S+)", recipe)
    (swept,) = re.findall(r"^TOYS := (.*)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    choices = dict(word.partition("=")[::2] for word in swept.split())
    kept = read_kept(ROOT / path)
    expected = product(*(choices[name].split(",") for name in ("dataset", "method", "seed")))
    assert set(kept[["scene", "method", "seed"]].astype(str).itertuples(index=False, name=None)) == set(expected)
