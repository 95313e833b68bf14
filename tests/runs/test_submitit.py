"""Sweeps through Hydra's submitit launcher, on this machine. It is an extra: `pip install 'envgs-bench[slurm]'`."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from fakes.runs import run, set_environment
from fakes.whole_sweeps import Start, alive, statuses, training, until

pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
pytestmark = pytest.mark.slow

SUBMITIT = "hydra/launcher=submitit_local"


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


def test_every_job_reports_back_and_what_is_done_is_reused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sweep = ("method.kind=fakes.methods:MeanColor,fakes.methods:Raises", "seed=0,1", SUBMITIT)
    assert run(tmp_path, *sweep, flags=("-m",)) == 1
    shown = capsys.readouterr().out
    assert shown.count("│ ok") == 2
    assert shown.count("│ failed") == 2
    assert shown.count("RuntimeError: the surfels are in a bad mood") == 2
    assert statuses(tmp_path) == ["failed", "failed", "ok", "ok"]
    assert run(tmp_path, *sweep, flags=("-m",)) == 1
    shown = capsys.readouterr().out
    assert shown.count("│ ok (reused)") == 2
    assert shown.count("│ failed (not retried)") == 2


def test_ctrl_c_ends_all_jobs_with_records(tmp_path: Path, start: Start) -> None:
    process = start("seed=0,1", "method.kind=fakes.methods:Waits", "steps=1000", SUBMITIT)
    until(lambda: len(training(tmp_path)) == 2)
    os.killpg(process.pid, signal.SIGINT)
    process.communicate(timeout=90)
    assert process.returncode == 130
    assert statuses(tmp_path / "runs") == ["interrupted", "interrupted"]
    assert alive(tmp_path) == []
