"""Sweeps that are killed anywhere and called again: only what is missing runs, and ends as it would have ended."""

from __future__ import annotations

import os
import random
import shutil
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from fakes.runs import only_folder, records, run, run_anew, set_environment
from fakes.whole_sweeps import Start, alive, statuses, sweep_of, training, until

from envgs_bench.records import Record, RecordError, find_records, read_record
from envgs_bench.run_folder import RECORD_NAME, REPLACEMENT
from envgs_bench.run_lock import LOCK_NAME
from envgs_bench.settings import read_settings
from envgs_bench.stages.execution import execute
from envgs_bench.stages.results import Results

STEPS = 150
LEARNS = ("method.kind=fakes.methods:Waits", "method.settings.rate=0.01", f"steps={STEPS}", "snapshot_minutes=0.005")
REAL = ("method=2dgs,envmap", "seed=0,1", "steps=100", "snapshot_minutes=0.005", "retry=failed")
VICTIMS = ("run", "sweep", "all")
# They hold times, folders, what was printed, or who was killed while he had locked the folder.
OF_THIS_ATTEMPT = ("record.json", "config.yaml", "curve.csv", "log.txt", LOCK_NAME)


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)
    monkeypatch.setenv("FAKE_STEP_SECONDS", "0.01")


def results(runs: Path) -> dict[str, Any]:
    """Of each finished run, what must be the same bit for bit: scores, pictures, model, the curve but for its seconds.

    Nothing of one whose replacement is finished: whoever comes next puts it in its place. One that is not finished
    stays where it is, to go on with force.
    """
    found: dict[str, Any] = {}
    for path in finished(runs):
        record, folder = read_record(path), path.parent
        if finished(folder / REPLACEMENT):
            continue
        assert record.metrics is not None
        assert record.cost is not None
        curve = (folder / "curve.csv").read_text().splitlines()
        files = [
            file
            for file in folder.rglob("*")
            if file.is_file() and file.name not in OF_THIS_ATTEMPT and folder / REPLACEMENT not in file.parents
        ]
        found[str(folder.relative_to(runs))] = {
            "metrics": record.metrics.model_dump(),
            "masked": {region: scores.model_dump() for region, scores in record.masked.items()},
            "primitives": record.cost.primitives,
            "curve": [line.split(",")[:1] + line.split(",")[2:] for line in curve],
            **{str(file.relative_to(folder)): file.read_bytes() for file in files},
        }
    return found


def finished(runs: Path) -> dict[Path, bytes]:
    """The records of what has ended with status ok."""
    found = find_records(runs) if runs.is_dir() else []
    return {path: path.read_bytes() for path in found if read_record(path).status == "ok"}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    root = tmp_path_factory.mktemp("undisturbed")
    with pytest.MonkeyPatch.context() as patch:
        set_environment(patch)
        assert run_anew(root, *REAL, flags=("-m",)) == 0  # with as many threads as the sweeps that are killed
    return results(root)


def kill_somebody(root: Path, start: Start, draw: random.Random, *overrides: str) -> str:
    """Start the sweep and kill, by SIGKILL at a random moment, a run, the sweep's own process, or all; say which.

    The moment is a random time after something that the sweep has come to, so that a slow machine, too, comes to all.
    A sweep whose run was killed goes on, and is killed a little later.
    """
    before, began = len(finished(root / "runs")), time.time()
    come_to: dict[str, Callable[[], object]] = {
        "starting": lambda: True,
        "a process": lambda: alive(root),
        "training": lambda: training(root),
        "a snapshot": lambda: any(path.stat().st_mtime > began for path in root.rglob("snapshot.safetensors")),
        "a result": lambda: len(finished(root / "runs")) > before or list(root.rglob(f"{REPLACEMENT}/{RECORD_NAME}")),
    }
    (moment,) = draw.choices(list(come_to), weights=[1, 1, 2, 3, 3])
    shell = start(*REAL, *overrides)

    def it_is_time() -> bool:
        with suppress(OSError, RecordError):  # files come and go
            return shell.poll() is not None or bool(come_to[moment]())
        return False

    until(it_is_time, 300)
    time.sleep(draw.uniform(0, 2))
    victim = draw.choice(VICTIMS)
    if shell.poll() is not None:
        victim = "nobody, it had ended"
    if victim in ("run", "all"):
        for process in alive(root):
            process.kill()
    if victim == "run":
        time.sleep(draw.uniform(0, 3))
    if victim == "sweep":
        with suppress(Exception):  # it may have ended at this moment
            sweep_of(shell).kill()
    else:
        with suppress(ProcessLookupError):
            os.killpg(shell.pid, signal.SIGKILL)
    shell.communicate(timeout=300)
    until(lambda: not alive(root))
    return victim


def _went_on(found: list[Record]) -> int:
    """How many of these runs went on from a snapshot, once or more often."""
    return sum("went_on_from_steps" in (record.provenance.model_extra or {}) for record in found)


def differing(done: dict[str, Any], expected: dict[str, Any]) -> dict[str, list[str]]:
    """Of each finished run that is not as expected, the names of what differs."""
    names = {
        run: sorted(it for it in {*left, *expected[run]} if left.get(it) != expected[run].get(it))
        for run, left in done.items()
    }
    return {run: differ for run, differ in names.items() if differ}


def kill_rounds(root: Path, start: Start, rounds: int, draw: random.Random, expected: dict[str, Any]) -> Counter[str]:
    """As many kills; where all is done, it is run again with force, or begun anew. How often what happened.

    Where none of them met a run with a snapshot, which is chance, there are up to three times as many.
    """
    runs = root / "runs"
    seen: Counter[str] = Counter()

    def went_on() -> int:
        return seen["went on"] + (_went_on(records(runs)) if runs.is_dir() else 0)

    while (kills := sum(seen[victim] for victim in VICTIMS)) < rounds or (not went_on() and kills < 3 * rounds):
        before, again = finished(runs), ()
        if len(before) == len(expected):
            seen["all done"] += 1
            if draw.random() < 0.5:
                again = ("force=true",)
            else:
                seen["went on"] = went_on()
                shutil.rmtree(runs)
                before = {}
        seen[kill_somebody(root, start, draw, *again)] += 1
        after, done = finished(runs), results(runs)
        seen["results"] += len(after.keys() - before.keys())
        assert before.keys() <= after.keys()
        if not again:
            assert {path: after[path] for path in before} == before  # neither lost nor run twice
        assert not differing(done, expected)
    assert run_anew(runs, *REAL, flags=("-m",)) == 0
    assert not differing(results(runs), expected)
    assert results(runs).keys() == expected.keys()
    seen["went on"] = went_on()
    return seen


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_a_sweep_that_was_killed_ten_times_goes_on(
    tmp_path: Path, start: Start, undisturbed: dict[str, Any], seed: int
) -> None:
    seen = kill_rounds(tmp_path, start, 10, random.Random(100 + seed), undisturbed)
    assert seen["went on"]
    print(f"what happened, how often: {dict(seen)}")


def test_a_run_that_was_killed_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ends where it ends in this process, in one go."""
    runs = tmp_path / "runs"

    def kill() -> None:
        until(lambda: list(runs.rglob("snapshot.safetensors")))
        for process in alive(runs):
            process.kill()

    threading.Thread(target=kill).start()
    assert run_anew(runs, *LEARNS) == 1
    assert statuses(runs) == ["out_of_memory"]  # as it seems from outside
    assert run(runs, *LEARNS, "retry=failed") == 0
    folder = only_folder(runs)
    (step,) = (read_record(folder).provenance.model_extra or {})["went_on_from_steps"]
    assert 0 < step < STEPS
    monkeypatch.setenv("FAKE_STEP_SECONDS", "0")
    whole = Results("tiny", STEPS)
    (tmp_path / "whole").mkdir()
    execute(read_settings(folder), tmp_path / "whole", whole, lambda event: None)
    assert whole.metrics == read_record(folder).metrics
    learned = (tmp_path / "whole" / "checkpoint" / "color.pt", folder / "checkpoint" / "color.pt")
    assert learned[0].read_bytes() == learned[1].read_bytes()


@pytest.mark.slow
def test_two_sweeps_of_one_folder_share_the_work(tmp_path: Path, start: Start) -> None:
    sweeps = [start("seed=0,1,2,3", *LEARNS), start("seed=0,1,2,3", *LEARNS)]
    for sweep in sweeps:
        sweep.communicate(timeout=200)
    assert statuses(tmp_path / "runs") == ["ok"] * 4
    logs = [path.read_text() for path in (tmp_path / "runs").rglob("log.txt")]
    assert [log.count("learning the mean color") for log in logs] == [1] * 4


@pytest.mark.parametrize("how", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_ctrl_c_and_kill_save_where_it_was_and_the_same_command_goes_on(
    tmp_path: Path, how: signal.Signals, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a long step's middle nothing is saved: the snapshot is of the step's end."""
    runs = tmp_path / "runs"

    def interrupt() -> None:
        until(lambda: training(tmp_path))
        time.sleep(0.5)
        os.kill(os.getpid(), how)

    threading.Thread(target=interrupt).start()
    assert run(runs, *LEARNS, "snapshot_minutes=60", "seed=0,1", flags=("-m",)) == 130
    shown = capsys.readouterr()
    assert "jobs done" not in shown.err
    assert ": interrupted; the same command goes on from where the training was saved last" in shown.out
    assert "KeyboardInterrupt" not in shown.out
    (record,) = records(runs)  # the sweep ended there
    assert record.status == "interrupted"
    assert record.seed == 0
    assert record.cost is not None
    folder = only_folder(runs)
    assert (folder / "checkpoint" / "color.pt").is_file()
    assert (folder / "curve.csv").read_text().startswith("step,")
    assert (folder / "snapshot.safetensors").is_file()

    assert run(runs, *LEARNS) == 0
    (record,) = records(runs)
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
