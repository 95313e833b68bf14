"""What the system refuses and what methods should not do: an outcome with a reason, and the sweep goes on."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fakes.runs import CONF, QUICK, environment, only_folder, records, run, run_here, set_environment

from envgs_bench.cli.main import main
from envgs_bench.records import read_record
from envgs_bench.run_folder import LOG_NAME, RECORD_NAME
from envgs_bench.run_lock import holder_of


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 2 MB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(disk)], capture_output=True)
    if mounted.returncode:
        pytest.skip(f"no tmpfs can be mounted: {mounted.stderr.decode().strip()}")
    yield disk
    subprocess.run(["umount", "-l", str(disk)], check=True)


def test_what_a_method_prints_is_bounded(tmp_path: Path) -> None:
    assert run(tmp_path, "method.kind=fakes.methods:Chatters") == 1
    folder = only_folder(tmp_path)
    log = (folder / LOG_NAME).read_text()
    assert len(log) < 2**21
    assert "the first line" in log
    assert "are left out here" in log
    assert log.rstrip().endswith("ends")
    assert (folder / RECORD_NAME).stat().st_size < 2**16
    error = read_record(folder).error
    assert error is not None
    assert error.message.startswith("begins b")
    assert error.message.endswith("b ends")
    assert error.log_tail.rstrip().endswith("ends")


def test_a_full_disk_is_an_outcome_and_the_sweep_goes_on(small_disk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fill = "method.kind=fakes.methods:FillsItsDisk"
    assert run(small_disk / "runs", fill, "seed=0,1", flags=("-m",)) == 1
    shown = capsys.readouterr().out
    assert shown.count("failed") >= 2
    assert "No space left on device" in shown
    (small_disk / "filler").unlink()
    assert run_here(small_disk / "runs", fill, "steps=3", "method.settings.crash_at=9") == 0


def test_a_folder_that_is_deleted_meanwhile_is_an_outcome(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, "method.kind=fakes.methods:DeletesItsFolder,fakes.methods:MeanColor", flags=("-m",)) == 1
    shown = capsys.readouterr().out
    assert "No such file or directory" in shown
    assert sorted(record.status for record in records(tmp_path)) == ["failed", "ok"]


def test_a_folder_that_cannot_be_written_is_an_outcome_and_what_is_there_is_reused(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    assert run(tmp_path) == 0
    folder = only_folder(tmp_path)
    folder.chmod(0o500)
    assert run(tmp_path) == 0
    assert run(tmp_path, "force=true") == 1
    folder.chmod(0o700)


def test_pipes_and_links_in_place_of_a_runs_files(tmp_path: Path) -> None:
    assert run(tmp_path / "runs", "method.kind=fakes.methods:Raises") == 1
    folder = only_folder(tmp_path / "runs")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "mine.png").touch()
    (folder / "renders").symlink_to(elsewhere)
    (folder / "notes.md").write_text("mine")
    (folder / LOG_NAME).unlink()
    os.mkfifo(folder / LOG_NAME)
    assert run(tmp_path / "runs", "method.kind=fakes.methods:Raises", "retry=failed") == 1
    assert (elsewhere / "mine.png").exists()
    assert (folder / "notes.md").read_text() == "mine"
    assert "the surfels are in a bad mood" in (folder / LOG_NAME).read_text()
    assert not (folder / "renders").exists()


def test_a_pipe_in_place_of_a_record_is_named(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    record = only_folder(tmp_path) / RECORD_NAME
    record.unlink()
    os.mkfifo(record)
    assert run(tmp_path) == 1
    assert f"{record}: cannot be read: it is a named pipe, expected a file" in capsys.readouterr().out


def test_a_linked_folder_is_never_emptied(finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(finished, tmp_path / "runs")
    folder = only_folder(tmp_path / "runs")
    kept = tmp_path / "kept"
    folder.rename(kept)
    folder.symlink_to(kept)
    before = (kept / RECORD_NAME).read_bytes()
    assert run(tmp_path / "runs", "force=true") == 0
    assert (kept / RECORD_NAME).read_bytes() == before
    assert "the folder is a link" in capsys.readouterr().out
    assert run(tmp_path / "runs") == 0


def test_a_forced_run_that_fails_leaves_the_result(finished: Path, tmp_path: Path) -> None:
    """The same run fails the second time, as of a full disk: its result stays, and what happened is said."""
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    folder = only_folder(tmp_path)
    before = (folder / RECORD_NAME).read_bytes()
    assert run(tmp_path, "force=true", "timeout_minutes=0.0001") == 1
    assert (folder / RECORD_NAME).read_bytes() == before
    assert read_record(folder / "replacement").status == "timeout"
    assert run_here(tmp_path, "force=true") == 0
    assert not (folder / "replacement").exists()
    assert (folder / RECORD_NAME).read_bytes() != before


@pytest.mark.slow
def test_names_are_shown_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither markup nor a terminal's escape sequences; and no formula reaches a spreadsheet."""
    names = ("a[/b]", "[red]c", "=1+1", "d\x1b[31me")
    for name in names:
        assert main(["run", "--config-dir", str(CONF), *QUICK, f"runs_dir={tmp_path}", f"dataset.name='{name}'"]) == 0
    shown = capsys.readouterr()
    assert "a[/b]" in shown.out
    assert "[red]c" in shown.out
    assert "\x1b" not in shown.out + shown.err
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "report")]) == 0
    assert "\x1b" not in (tmp_path / "report" / "table.md").read_text()
    rows = (tmp_path / "report" / "table.csv").read_text().splitlines()
    assert any("'=1+1" in row for row in rows)
    assert not any(cell.startswith("=") for row in rows for cell in row.split(","))


@pytest.mark.slow
def test_a_run_under_way_is_no_unreadable_one(tmp_path: Path, start, capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[no-untyped-def]
    from fakes.whole_sweeps import training, until

    def stepped() -> bool:
        return any((at := holder_of(folder)) and at.progress.get("step") for folder in training(tmp_path))

    assert run(tmp_path / "runs") == 0
    start("method.kind=fakes.methods:Waits", "steps=1000")
    until(stepped)
    capsys.readouterr()
    assert main(["report", str(tmp_path / "runs"), "--out", str(tmp_path / "report")]) == 0
    assert "unreadable" not in capsys.readouterr().out
    assert main(["status", str(tmp_path / "runs")]) == 0
    shown = capsys.readouterr().out
    assert "2 runs: 1 running, 1 ok" in shown or "2 runs: 1 ok, 1 running" in shown
    assert "/1000" in shown
    assert " left" in shown


def test_a_dry_run_says_what_would_run(finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    assert run_here(tmp_path, "seed=0", "method.kind=fakes.methods:Raises") == 1
    before = sorted(tmp_path.rglob("*"))
    capsys.readouterr()
    assert run(tmp_path, "seed=0,1,2", flags=("-m", "--dry-run")) == 0
    shown = capsys.readouterr().out
    assert "2 to run, about" in shown
    assert "one after the other; 1 not to run" in shown
    assert "ok (reused)" in shown
    assert run(tmp_path, "seed=0", "method.kind=fakes.methods:Raises", flags=("--dry-run",)) == 0
    assert "failed (not retried)" in capsys.readouterr().out
    assert [path for path in sorted(tmp_path.rglob("*")) if path.name != "multirun.yaml"] == before


def test_a_dry_run_into_a_pipe_shortens_no_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    named = ("dataset.name=captures/a_room_with_a_mirror", "method.name=fake_of_a_long_name")
    assert run(tmp_path, *named, flags=("--dry-run",)) == 0
    shown = capsys.readouterr().out
    assert "captures/a_room_with_a_mirror" in shown
    assert "fake_of_a_long_name" in shown


@pytest.mark.slow
def test_a_sweep_says_which_job_it_is_at(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "envgs_bench.cli.main", "run", "--config-dir", str(CONF), "-m", *QUICK]
    result = subprocess.run(
        [*command, "seed=0,1", "method.settings.rate=0.1,0.2", f"runs_dir={tmp_path}"],
        capture_output=True,
        text=True,
        env={**os.environ, **environment()},
        check=True,
    )
    assert "[3/4] tiny · fake · seed 1: starting" in result.stderr
    assert "2 of 4 jobs done in " in result.stderr
