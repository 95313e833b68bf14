"""Ctrl-C, SIGTERM, SIGKILL and lost terminals, sent to whole sweeps: nothing finished is lost, and nobody hangs."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from fakes.runs import only_folder, records, run, run_anew, set_environment
from fakes.whole_sweeps import Start, alive, lives, statuses, sweep_of, training, until

from envgs_bench.records import read_record
from envgs_bench.run_lock import holder_of

JOBLIB = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
LONG = ("steps=5000", "method.settings.tells_psnr=false")
WAITS = ("method.kind=fakes.methods:Waits", "steps=1000")


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


@pytest.mark.slow
def test_ctrl_c_through_a_pipe_keeps_what_is_finished(
    tmp_path: Path, start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`2>&1 | tee log`: tee ends first, and every line printed from then on meets a broken pipe."""
    monkeypatch.chdir(tmp_path)
    sweep = ("seed=0,1,2", "steps=50", "method.kind=fakes.methods:Announces")
    (tmp_path / "started").touch()  # it is quick
    assert run(Path("runs"), *sweep, flags=("-m",)) == 0
    before = {path: path.read_bytes() for path in (tmp_path / "runs/tiny").rglob("*") if path.is_file()}
    (tmp_path / "started").unlink()
    process = start(*sweep, "force=true", pipe="2>&1 | tee log")
    until(lambda: (tmp_path / "started").exists())
    os.killpg(process.pid, signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 130
    assert {path: path.read_bytes() for path in before} == before
    assert statuses(tmp_path / "runs") == ["ok", "ok", "ok"]
    assert alive(tmp_path) == []


def test_a_closed_output_stops_nothing(tmp_path: Path, start: Start) -> None:
    process = start("steps=300", pipe="2>&1 | head -1")
    out, _ = process.communicate(timeout=120)
    assert len(out.splitlines()) == 1
    assert process.returncode == 0
    assert statuses(tmp_path / "runs") == ["ok"]


@pytest.mark.slow
def test_a_full_log_disk_stops_nothing(tmp_path: Path, start: Start) -> None:
    process = start("seed=0,1", *LONG, pipe="> /dev/full 2>&1")
    process.communicate(timeout=120)
    assert process.returncode == 0
    assert statuses(tmp_path / "runs") == ["ok", "ok"]


@pytest.mark.slow
def test_a_terminal_that_stands_still_stops_no_run(tmp_path: Path, start: Start) -> None:
    """Nobody reads: the sweep waits to print, its run does not."""
    process = start(*LONG, "method.kind=fakes.methods:Complains", pipe="2>&1 | sleep 600")
    until(lambda: statuses(tmp_path / "runs") == ["ok"])
    assert process.poll() is None


@pytest.mark.parametrize("delay", [0.0, pytest.param(0.3, marks=pytest.mark.slow)])
def test_ctrl_c_just_after_a_record_ends_the_sweep(tmp_path: Path, start: Start, delay: float) -> None:
    process = start("seed=" + ",".join(map(str, range(12))))
    until(lambda: statuses(tmp_path / "runs"))
    time.sleep(delay)
    os.killpg(process.pid, signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 130
    found = statuses(tmp_path / "runs")
    assert len(found) < 12
    assert found.count("ok") >= 1
    assert "│ ok" in out


@pytest.mark.slow
@pytest.mark.parametrize("how", ["terminal", "SIGTERM"])
def test_joblib_ends_its_runs_with_records(tmp_path: Path, start: Start, how: str) -> None:
    process = start("seed=0,1,2,3", *WAITS, *JOBLIB)
    until(lambda: len(training(tmp_path)) == 2)
    if how == "terminal":
        os.killpg(process.pid, signal.SIGINT)
    else:
        sweep_of(process).terminate()
    out, _ = process.communicate(timeout=90)
    assert process.returncode == 130
    assert statuses(tmp_path / "runs") == ["interrupted", "interrupted"]
    assert out.count("interrupted │") == 2
    for record in (tmp_path / "runs").rglob("record.json"):
        assert (record.parent / "checkpoint" / "color.pt").is_file()
    assert alive(tmp_path) == []


@pytest.mark.parametrize("launcher", [(), pytest.param(JOBLIB, marks=pytest.mark.slow)])
def test_a_killed_sweep_takes_its_runs_with_it(tmp_path: Path, start: Start, launcher: tuple[str, ...]) -> None:
    process = start("seed=0,1,2,3", *WAITS, *launcher)
    until(lambda: len(training(tmp_path)) == (2 if launcher else 1))
    main = sweep_of(process)
    below = main.children(recursive=True)
    main.kill()
    until(lambda: not alive(tmp_path), 15)
    until(lambda: not any(one.is_running() and one.status() != "zombie" for one in below), 15)
    assert set(statuses(tmp_path / "runs")) == {"interrupted"}
    assert len(records(tmp_path / "runs")) == (2 if launcher else 1)


def test_what_a_worker_leaves_behind_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    began = time.monotonic()
    assert run_anew(tmp_path / "runs", "method.kind=fakes.methods:LeavesProcesses") == 0
    assert time.monotonic() - began < 120  # those that are left sleep for ten minutes
    left = [int(number) for number in (tmp_path / "left").read_text().split()]
    assert len(left) == 3
    until(lambda: not any(lives(number) for number in left), 15)
    assert holder_of(only_folder(tmp_path / "runs")) is None


@pytest.mark.slow
def test_what_a_killed_sweep_left_holds_no_lock(tmp_path: Path, start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sweep and its worker are killed at once; a child of the worker, which has its files, lives on."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("envgs_bench.runs.job.GRACE_SECONDS", 1.0)
    overrides = ("method.kind=fakes.methods:LeavesProcesses", *LONG)
    process = start(*overrides, "runs_dir=runs")
    until(lambda: (tmp_path / "left").exists())
    left = {int(number) for number in (tmp_path / "left").read_text().split()}
    for one in [sweep_of(process), *alive(tmp_path)]:
        if one.pid not in left:
            one.kill()
    assert alive(tmp_path)
    assert run(Path("runs"), *overrides) == 0
    assert read_record(only_folder(tmp_path / "runs")).status == "ok"
    assert alive(tmp_path) == []


def test_a_thread_that_never_ends_does_not_hold_the_sweep(tmp_path: Path) -> None:
    assert run(tmp_path, "method.kind=fakes.methods:LeavesAThread") == 0
