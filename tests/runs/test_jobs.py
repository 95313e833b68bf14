"""Reuse, force, retry, unreadable records, two processes at one run, and Ctrl-C."""

from __future__ import annotations

import fcntl
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from fakes.runs import CONF, QUICK, only_folder, records, run, set_environment

from envgs_bench.claim import CLAIM_NAME

RAISES = "method.kind=fakes.methods:Raises"


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A runs_dir with one finished run."""
    runs_dir = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        set_environment(patch)
        assert run(runs_dir) == 0
    return runs_dir


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
    assert run(tmp_path, "force=true") == 0
    assert "reused" not in capsys.readouterr().out
    assert record.read_bytes() != before
    assert not (record.parent / "renders" / "old.png").exists()


def test_a_failed_run_is_retried_only_when_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, RAISES) == 1
    record = only_folder(tmp_path) / "record.json"
    before = record.read_bytes()
    capsys.readouterr()

    assert run(tmp_path, RAISES) == 1
    out = capsys.readouterr().out
    assert "failed (not retried)" in out
    assert "RuntimeError: the surfels are in a bad mood (retry=failed runs it again)" in out
    assert record.read_bytes() == before

    assert run(tmp_path, RAISES, "retry=timeout") == 1
    assert record.read_bytes() == before
    capsys.readouterr()

    assert run(tmp_path, RAISES, "retry=failed") == 1
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
    handle = os.open(folder / CLAIM_NAME, os.O_RDWR | os.O_CREAT)
    fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        assert run(tmp_path, "force=true") == 0  # the record that is there is good
    finally:
        os.close(handle)
    out = capsys.readouterr().out
    assert "ok (skipped)" in out
    assert "another process is running it" in out


@pytest.mark.parametrize("how", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_ctrl_c_and_kill_leave_a_record_and_a_checkpoint_and_the_run_starts_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: signal.Signals
) -> None:
    command = [sys.executable, "-m", "envgs_bench.cli.main", "run", "--config-dir", str(CONF), "-m", *QUICK]
    overrides = ["runs_dir=runs", "seed=0,1", "steps=1000", "method.kind=fakes.methods:Announces"]
    process = subprocess.Popen(
        [*command, *overrides],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # a background shell ignores it
    )
    for _ in range(600):
        if (tmp_path / "started").exists() or process.poll() is not None:
            break
        time.sleep(0.1)
    process.send_signal(how)
    out, _ = process.communicate(timeout=60)

    assert process.returncode == 130
    assert "interrupted" in out
    (record,) = records(tmp_path / "runs")  # the sweep ended there
    assert record.status == "interrupted"
    assert record.seed == 0
    assert record.cost is not None
    folder = only_folder(tmp_path / "runs")
    assert (folder / "checkpoint" / "color.pt").is_file()
    assert (folder / "curve.csv").read_text().startswith("step,")

    monkeypatch.chdir(tmp_path)
    assert run(Path("runs"), "steps=1000", "method.kind=fakes.methods:Announces") == 0
    (record,) = records(tmp_path / "runs")
    assert record.status == "ok"
