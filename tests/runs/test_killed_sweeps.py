"""Sweeps that are killed anywhere and called again: only what is missing runs, and ends as it would have ended."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import time
from contextlib import suppress
from pathlib import Path

import pytest
import torch
from fakes.runs import only_folder, records, run, set_environment
from fakes.whole_sweeps import Start, alive, statuses, training, until

from envgs_bench.records import find_records, read_record

STEPS = 400
SEEDS = "seed=0,1,2"
LEARNS = ("method.kind=fakes.methods:Waits", "method.settings.rate=0.01", f"steps={STEPS}", "snapshot_minutes=0.005")


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)
    monkeypatch.setenv("FAKE_STEP_SECONDS", "0.01")


def results(runs: Path) -> dict[int, tuple[object, torch.Tensor, str]]:
    """Of each seed, what must be the same bit for bit: scores, what was learned, and the curve but for its seconds."""
    found = {}
    for path in find_records(runs):
        record = read_record(path)
        assert record.metrics is not None
        curve = (path.parent / "curve.csv").read_text().splitlines()
        rows = [line.split(",")[:1] + line.split(",")[2:] for line in curve]
        color = torch.load(path.parent / "checkpoint" / "color.pt", weights_only=True)
        found[record.seed] = record.metrics.model_dump(), color.tolist(), json.dumps(rows)
    return found


def finished_records(runs: Path) -> list[Path]:
    return [path for path in find_records(runs) if read_record(path).status == "ok"] if runs.is_dir() else []


def kill_somebody(tmp_path: Path, start: Start, draw: random.Random) -> None:
    """Start the sweep and kill, at a random moment, the worker, all of the sweep but the worker, or both."""
    sweep = start(SEEDS, *LEARNS)
    until(lambda: alive(tmp_path) or sweep.poll() is not None)
    time.sleep(draw.uniform(0, 8))
    victims = draw.choice(["worker", "sweep", "both"])
    if victims != "sweep":
        for process in alive(tmp_path):
            process.kill()
    with suppress(ProcessLookupError):
        os.killpg(sweep.pid, signal.SIGTERM if victims == "worker" else signal.SIGKILL)
    sweep.communicate(timeout=120)
    until(lambda: not alive(tmp_path))


def kill_rounds(tmp_path: Path, start: Start, rounds: int, draw: random.Random) -> None:
    """As many kills at random moments, the folder begun anew where all is done; the results are those of no kill."""
    runs = tmp_path / "runs"
    assert run(tmp_path / "whole", *LEARNS, SEEDS, flags=("-m",)) == 0
    expected = results(tmp_path / "whole")

    for _ in range(rounds):
        finished = {path: path.read_bytes() for path in finished_records(runs)}
        kill_somebody(tmp_path, start, draw)
        assert {path: path.read_bytes() for path in finished} == finished
        if len(finished) == 3:
            shutil.rmtree(runs)
    assert run(runs, *LEARNS, SEEDS, "retry_failed=true", flags=("-m",)) == 0
    assert statuses(runs) == ["ok"] * 3
    assert results(runs) == expected
    resumed = sum(len((record.provenance.model_extra or {}).get("went_on_from_steps", [])) for record in records(runs))
    assert resumed


@pytest.mark.slow
def test_a_sweep_that_was_killed_goes_on(tmp_path: Path, start: Start) -> None:
    kill_rounds(tmp_path, start, 3, random.Random(1))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_a_sweep_that_was_killed_ten_times_goes_on(tmp_path: Path, start: Start, seed: int) -> None:
    kill_rounds(tmp_path, start, 10, random.Random(100 + seed))


@pytest.mark.slow
def test_two_sweeps_of_one_folder_share_the_work(tmp_path: Path, start: Start) -> None:
    sweeps = [start("seed=0,1,2,3", *LEARNS), start("seed=0,1,2,3", *LEARNS)]
    for sweep in sweeps:
        sweep.communicate(timeout=200)
    assert statuses(tmp_path / "runs") == ["ok"] * 4
    logs = [path.read_text() for path in (tmp_path / "runs").rglob("log.txt")]
    assert [log.count("learning the mean color") for log in logs] == [1] * 4


def test_ctrl_c_saves_where_it_was_and_the_same_command_goes_on(tmp_path: Path, start: Start) -> None:
    """Of a long step's middle nothing is saved: the snapshot is of the step's end."""
    sweep = start(*LEARNS, "snapshot_minutes=60")
    until(lambda: training(tmp_path))
    time.sleep(0.5)
    os.killpg(sweep.pid, signal.SIGINT)
    sweep.communicate(timeout=60)
    folder = only_folder(tmp_path / "runs")
    assert (folder / "snapshot.safetensors").is_file()
    assert run(tmp_path / "runs", *LEARNS) == 0
    record = read_record(folder)
    assert record.status == "ok"
    (step,) = (record.provenance.model_extra or {})["went_on_from_steps"]
    assert 0 < step < STEPS
    assert record.cost is not None
    assert record.cost.train_seconds > 0.01 * STEPS * 0.9  # of both parts
    assert not (folder / "snapshot.safetensors").exists()


@pytest.mark.slow
def test_force_starts_again(tmp_path: Path, start: Start) -> None:
    sweep = start(*LEARNS)
    until(lambda: training(tmp_path))
    os.killpg(sweep.pid, signal.SIGINT)
    sweep.communicate(timeout=60)
    assert run(tmp_path / "runs", *LEARNS, "force=true") == 0
    (record,) = records(tmp_path / "runs")
    assert record.status == "ok"
    assert "went_on_from_steps" not in (record.provenance.model_extra or {})
