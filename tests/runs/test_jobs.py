"""Reuse, force, retry, unreadable records, and two processes at one run."""

from __future__ import annotations

import fcntl
import os
import shutil
from pathlib import Path

import pytest
from fakes.runs import only_folder, run, run_here, set_environment

from envgs_bench.run_lock import LOCK_NAME

RAISES = "method.kind=fakes.methods:Raises"


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


def test_a_finished_run_is_reused_unless_forced(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    record = only_folder(tmp_path) / "record.json"
    before = record.read_bytes()

    assert run(tmp_path, "timeout_minutes=5") == 0
    assert "ok (reused)" in capsys.readouterr().out
    assert record.read_bytes() == before

    (record.parent / "renders" / "old.png").touch()
    assert run_here(tmp_path, "force=true") == 0
    assert "reused" not in capsys.readouterr().out
    assert record.read_bytes() != before
    assert not (record.parent / "renders" / "old.png").exists()


def test_a_failed_run_is_retried_only_when_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_here(tmp_path, RAISES) == 1
    record = only_folder(tmp_path) / "record.json"
    before = record.read_bytes()
    capsys.readouterr()

    assert run_here(tmp_path, RAISES) == 1
    out = capsys.readouterr().out
    assert "failed (not retried)" in out
    assert "RuntimeError: the surfels are in a bad mood (retry=failed runs it again)" in out
    assert record.read_bytes() == before

    assert run_here(tmp_path, RAISES, "retry=timeout") == 1
    assert record.read_bytes() == before
    capsys.readouterr()

    assert run_here(tmp_path, RAISES, "retry=failed") == 1
    assert "not retried" not in capsys.readouterr().out
    assert record.read_bytes() != before


def test_a_truncated_record_is_named_and_left_alone(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    folder = only_folder(tmp_path)
    record = folder / "record.json"
    record.write_bytes(record.read_bytes()[:200])

    assert run(tmp_path) == 1
    out = capsys.readouterr().out
    assert f"{record}: not valid JSON (truncated?)" in out
    assert record.stat().st_size == 200
    assert (folder / "renders" / "view0.png").exists()


def test_a_run_that_another_process_is_at_is_left_to_it(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    folder = only_folder(tmp_path)
    handle = os.open(folder / LOCK_NAME, os.O_RDWR | os.O_CREAT)
    fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        assert run(tmp_path, "force=true") == 0  # the record that is there is good
    finally:
        os.close(handle)
    out = capsys.readouterr().out
    assert "ok (skipped)" in out
    assert "another process is running it" in out


def test_warnings_of_trainings_are_told_below_the_table_of_reused_runs_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for steps in ("1,2", "2,1"):
        assert run_here(tmp_path, f"steps={steps}", flags=("-m",)) == 0
        below = capsys.readouterr().out.rpartition("└")[2]
        said = (
            f"2 of 2 runs: warning: run short: each of 4 training views is learned from {int(steps[0]) / 4:.1f} times"
        )
        assert below.count("warning: run short: ") == below.count(said) == 1
