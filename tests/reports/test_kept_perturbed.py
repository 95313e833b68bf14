"""Kept perturbed runs and counts: short CSVs, and tables of what was lost, warned of and repaired."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from reports_runs import record, run_folder, write_failure, write_record

from envgs_bench.cli.main import main
from envgs_bench.reports.documentation import fill_page
from envgs_bench.reports.kept.perturbed_file import COLUMNS, read_perturbed
from envgs_bench.reports.kept.runs_file import RunsFileError

ROOM = "toy/chrome_room"


def perturbed(kind: str, severity: int, drop: float, warnings: tuple[tuple[str, int], ...] = (), **changes: Any) -> Any:
    """A record of EnvGS's that lies `drop` dB below its partner's."""
    own = record(ROOM, "envgs", 0, (60, 80), **changes)
    own["metrics"]["mean"]["psnr"] -= drop
    if kind:
        own["perturbation"] = {"kind": kind, "severity": severity, "level": f"{kind} {severity}"}
    own["warnings"] = [{"kind": name, "step": step, "part": "", "message": "seen"} for name, step in warnings]
    return own


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """Runs of a room that is sparse anyway: exposures, repaired once, noise, and blur, of which one run diverged."""
    sparse = (("views_sparse", 0),)
    exposed = (*sparse, ("exposures_differ", 0))
    found = [
        perturbed("", 0, 0.0, sparse),
        perturbed("exposure", 1, 0.25, exposed),
        perturbed("exposure", 2, 1.5, exposed),
        perturbed("exposure", 2, 0.5, sparse, repair=["exposures"]),
        perturbed("noise", 1, 2.0, sparse),
        perturbed("noise", 2, 4.0, (*sparse, ("degenerate", 90))),
        perturbed("blur", 1, 1.0, sparse),
    ]
    for number, each in enumerate(found):
        folder = run_folder(tmp_path / "runs", ROOM, "envgs", number)
        write_record(folder, each)
    write_failure(tmp_path / "runs", ROOM, "envgs", 90, "diverged", "loss is nan")
    (path,) = (tmp_path / "runs").rglob("seed90*/record.json")
    content = json.loads(path.read_text(encoding="utf-8"))
    content |= {"seed": 0, "perturbation": {"kind": "blur", "severity": 2, "level": "blur 2"}}
    path.write_text(json.dumps(content), encoding="utf-8")
    assert main(["report", str(tmp_path / "runs"), "--keep-perturbed", str(tmp_path / "kept" / "perturbed.csv")]) == 0
    return tmp_path / "kept"


def filled(folder: Path, comment: str) -> list[list[str]]:
    """The cells of the table's lines."""
    page = folder / "page.md"
    page.write_text(f"<!-- table: {comment} -->\nold\n<!-- end of table -->\n", encoding="utf-8")
    lines = fill_page(page, folder)[0].splitlines()
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith("|")]


def test_a_row_has_what_was_perturbed_said_and_repaired(kept: Path) -> None:
    rows = read_perturbed(kept / "perturbed.csv")
    assert tuple(rows.columns) == COLUMNS
    assert len(rows) == 8
    run = rows[(rows["perturbed"] == "noise") & (rows["severity"] == "2")].iloc[0]
    assert (run["before"], run["during"], run["repair"], run["status"]) == ("views_sparse", "degenerate", "none", "ok")
    assert main(["report", str(kept.parent / "runs"), "--keep-perturbed", str(kept / "perturbed.csv")]) == 0
    pd.testing.assert_frame_equal(read_perturbed(kept / "perturbed.csv"), rows)


def test_recall_counts_runs_that_lost_and_warnings_that_their_partner_has_not(kept: Path) -> None:
    table = {line[0]: line[1:] for line in filled(kept, "recall records=perturbed.csv")}
    assert table["`exposure`"] == ["2", "1", "1", "1"]
    assert table["`noise`"] == ["2", "2", "0", "1"]
    assert table["`blur`"] == ["2", "2", "0", "0"]  # one lost 1 dB, one did not finish
    assert table["all"] == ["6", "5", "1", "2"]
    assert {line[0]: line[2] for line in filled(kept, "recall records=perturbed.csv least=3")}["all"] == "2"


def test_lag_is_between_the_first_warning_and_the_first_loss(kept: Path) -> None:
    table = {line[0]: line[1:] for line in filled(kept, "lag records=perturbed.csv")}
    assert table["`exposure`"] == ["1", "1", "0", "0", "0"]
    assert table["`noise`"] == ["1", "0", "0", "0", "1"]
    assert table["all"] == ["3", "1", "0", "0", "2"]


def test_a_repair_has_a_column_and_says_where_it_changes_nothing(kept: Path) -> None:
    table = {line[0]: line[1:] for line in filled(kept, "stability records=perturbed.csv")}
    assert table[""] == ["`envgs`", "`envgs`, repair=exposures"]
    assert table["`exposure` 2"] == ["−1.50", "−0.50"]
    assert table["`exposure` 1"] == ["−0.25", "–"]  # it would have changed something, and was not run
    assert table["`noise` 1"] == ["−2.00", "="]
    assert table["`blur` 2"] == ["– (0/1)", "="]


def test_a_perturbed_run_is_not_kept_among_others(kept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(kept.parent / "runs"), "--keep", str(kept / "runs.csv")]) != 0
    assert "--keep-perturbed" in capsys.readouterr().err


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "other.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    with pytest.raises(RunsFileError, match="it has no scene"):
        read_perturbed(tmp_path / "other.csv")


def test_counts_have_a_column_a_size_and_the_share_that_they_leave_possible(tmp_path: Path) -> None:
    size = {"width": 64, "height": 48, "views": 28}
    rows = [{"seed": s, **size, "spoiled": "", "severity": 0, "warned": "", "repaired": ""} for s in range(299)]
    rows += [{**rows[0], "width": 96, "height": 72, "seed": 500 + s, "warned": "poses_off"} for s in range(2)]
    rows += [{**rows[0], "spoiled": "exposure", "severity": 2, "repaired": "exposures"}]
    pd.DataFrame(rows).to_csv(tmp_path / "counts.csv", index=False)
    table = {line[0]: line[1:] for line in filled(tmp_path, "false_alarms records=counts.csv")}
    assert table["in order"] == ["64×48", "96×72", "all", "at most"]
    assert table["`poses_off`"][:3] == ["0 of 299", "2 of 2", "2 of 301"]
    assert table["`repair=normals`"] == ["0 of 299", "0 of 2", "0 of 301", "1.0 %"]  # three in three hundred
    assert ["`exposure` 2: `repair=exposures`", "1 of 1", "1 of 1", "5.0 %"] in filled(
        tmp_path, "found records=counts.csv"
    )
