"""A sweep of sixty runs, most of them planted to fail, killed on the way and called again: every status is right."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from collections import Counter
from pathlib import Path

import pytest
from fakes.runs import run, set_environment
from fakes.whole_sweeps import Start, alive, until

from envgs_bench.cli.main import main
from envgs_bench.records import find_records, read_record

EXPECTED = {
    "MeanColor": "ok",
    "LeavesProcesses": "ok",
    "LeavesAThread": "ok",
    "Raises": "failed",
    "Segfaults": "failed",
    "Exits": "failed",
    "LosesItsLoss": "diverged",
    "RendersNaN": "diverged",
    "RunsOutOfMemory": "out_of_memory",  # at once
    "TakesMemory": "out_of_memory",  # bit by bit, beyond memory_gb
    "IsKilled": "out_of_memory",  # as the system does it
    "Waits": "timeout",
    "Hangs": "timeout",  # and heeds no signal
}
SEEDS = range(5)
KILLS = 6
LIMITS = ("timeout_minutes=0.75", "memory_gb=0.5", "snapshot_minutes=0.02")
SWEEP = (
    "method.kind=" + ",".join(f"fakes.methods:{kind}" for kind in EXPECTED),
    "seed=" + ",".join(map(str, SEEDS)),
    *("steps=200", "method.settings.crash_at=5", *LIMITS),
)
JOBLIB = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")


def kill(root: Path, shell: subprocess.Popen[str], with_runs: bool) -> None:
    """SIGKILL to the sweep's processes, and to those of its runs, which otherwise end by themselves."""
    os.killpg(shell.pid, signal.SIGKILL)
    for process in alive(root) if with_runs else []:
        process.kill()
    shell.communicate(timeout=60)
    until(lambda: not alive(root))


@pytest.mark.slow
def test_every_status_is_right(
    tmp_path: Path, start: Start, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    set_environment(monkeypatch)
    monkeypatch.setenv("FAKE_STEP_SECONDS", "1")
    monkeypatch.chdir(tmp_path)
    draw, began = random.Random(0), time.monotonic()
    for number in range(KILLS):
        shell = start(*SWEEP, *JOBLIB)
        time.sleep(draw.uniform(15, 60))
        assert shell.poll() is None, "it had nothing left to do"
        kill(tmp_path, shell, with_runs=number % 2 == 0)
    shell = start(*SWEEP, *JOBLIB)
    shell.communicate(timeout=3600)
    assert shell.returncode == 1
    seconds = time.monotonic() - began

    runs = tmp_path / "runs"
    records = [read_record(path) for path in find_records(runs)]
    seen = Counter((record.kind.partition(":")[2], record.status) for record in records)
    assert seen == {(kind, status): len(SEEDS) for kind, status in EXPECTED.items()}
    assert len(list(runs.rglob("config.yaml"))) == len(records)  # none is without a record
    assert all(record.metrics is None or record.status == "ok" for record in records)

    before = {path: path.read_bytes() for path in find_records(runs)}
    capsys.readouterr()
    assert run(Path("runs"), *SWEEP, flags=("-m",)) == 1
    shown = capsys.readouterr().out
    for status, count in Counter(EXPECTED.values()).items():
        state = f"│ {status} (reused)" if status == "ok" else f"│ {status} (not retried)"
        assert shown.count(state) == count * len(SEEDS)
    assert {path: path.read_bytes() for path in find_records(runs)} == before
    assert main(["report", "runs", "--out", "report"]) == 0
    print(f"{len(records)} runs, {KILLS} kills, {seconds:.0f} s: {dict(Counter(record.status for record in records))}")
