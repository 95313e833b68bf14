"""Loggers: what each library reads back of what a training told it."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes.runs import only_folder, records, run, run_job_here, set_environment

from envgs_bench.loggers import opening
from envgs_bench.loggers.opening import Guarded, logging_of
from envgs_bench.run_folder import LOGGED
from envgs_bench.settings import RunSettings, parse_settings

PICTURE = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)


def settings_of(kind: str | None, runs_dir: Path) -> RunSettings:
    return parse_settings(
        {
            "method": {"name": "2dgs", "kind": "2dgs"},
            "dataset": {"name": "toy/glass", "kind": "toy"},
            **{"protocol": "envgs", "seed": 3, "steps": 10, "device": "cpu", "timeout_minutes": None},
            **{"timing": {"frames": 1, "seconds": 0.01}, "force": False, "cache_dir": None, "runs_dir": str(runs_dir)},
            "logger": kind and {"kind": kind, "every": 5, "views": 1},
        }
    )


def told(kind: str, tmp_path: Path, *parts: list[int]) -> Path:
    """The logs of a run that told its logger losses at the steps of each part, and a picture at each part's end."""
    folder = tmp_path / "seed3-0123abcd"
    for steps in parts:
        with logging_of(settings_of(kind, tmp_path), folder) as logger:
            assert logger is not None
            for step in steps:
                logger.numbers(step, {"training/loss": 1 / step, "training/psnr": 20.0 + step})
            logger.picture(steps[-1], "test/0000", PICTURE)
    return folder / LOGGED


def test_tensorboard_reads_numbers_and_pictures_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    folder = told("tensorboard", tmp_path, [1, 2], [3])
    assert "goes on without" not in capsys.readouterr().err
    events = accumulator.EventAccumulator(str(folder))
    events.Reload()
    losses = [(event.step, event.value) for event in events.Scalars("training/loss")]
    assert losses == [(1, 1.0), (2, 0.5), (3, pytest.approx(1 / 3))]
    assert [event.step for event in events.Images("test/0000")] == [2, 3]
    assert decoded(events.Images("test/0000")[0].encoded_image_string) == PICTURE.tolist()


def decoded(png: bytes) -> list[Any]:
    from io import BytesIO

    from PIL import Image

    return np.asarray(Image.open(BytesIO(png))).tolist()


def blocks(content: bytes) -> Iterator[bytes]:
    """What a wandb file holds, in LevelDB's log format: blocks of 32 KiB, parts with a CRC, a length and a kind."""
    at, whole = 7, b""  # after the file's own head
    while at + 7 <= len(content):
        room = 32768 - at % 32768
        if room < 7:
            at += room
            continue
        length, kind = int.from_bytes(content[at + 4 : at + 6], "little"), content[at + 6]
        whole += content[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (1, 4):  # all of it, or the last part
            yield whole
            whole = b""


@pytest.mark.slow
def test_wandb_is_offline_and_its_run_is_named_after_the_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("wandb")
    from wandb.proto.wandb_internal_pb2 import Record

    monkeypatch.delenv("WANDB_MODE", raising=False)
    folder = told("wandb", tmp_path, [1, 2, 3])
    assert "goes on without" not in capsys.readouterr().err
    (file,) = (folder / "wandb").glob("offline-run-*/run-*.wandb")
    assert file.stem == f"run-{hashlib.sha256(str(folder).encode()).hexdigest()[:16]}"  # the same where it goes on
    rows: list[dict[str, str]] = []
    for data in blocks(file.read_bytes()):
        record = Record()
        record.ParseFromString(data)
        if record.WhichOneof("record_type") == "history":
            rows.append({item.key or item.nested_key[0]: item.value_json for item in record.history.item})
    losses = {int(row["_step"]): float(row["training/loss"]) for row in rows if "training/loss" in row}
    assert losses == {1: 1.0, 2: 0.5, 3: pytest.approx(1 / 3)}
    assert len(list((folder / "wandb").glob("offline-run-*/files/**/*.png"))) == 1


@pytest.mark.slow
def test_mlflow_has_one_run_in_a_database_beside_the_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mlflow = pytest.importorskip("mlflow")
    pytest.importorskip("alembic")
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    told("mlflow", tmp_path, [1, 2], [3])
    assert "goes on without" not in capsys.readouterr().err
    client = mlflow.MlflowClient(f"sqlite:///{tmp_path / 'mlflow.db'}")
    (found,) = client.search_runs([client.get_experiment_by_name("toy/glass").experiment_id])
    assert (found.info.run_name, found.info.status) == ("2dgs seed 3", "FINISHED")
    assert found.data.params["steps"] == "10"
    history = client.get_metric_history(found.info.run_id, "training/loss")
    assert [(item.step, item.value) for item in history] == [(1, 1.0), (2, 0.5), (3, 1 / 3)]
    assert len(list((tmp_path / "mlflow_pictures").rglob("*.png"))) == 2


class Failing:
    """A logger whose disk is full at the second number."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def numbers(self, step: int, values: Mapping[str, float]) -> None:
        self.calls.append(f"numbers {step}")
        if step == 2:
            raise OSError("no space left")

    def picture(self, step: int, name: str, picture: np.ndarray) -> None:
        self.calls.append("picture")

    def close(self) -> None:
        self.calls.append("close")


def test_a_logger_that_fails_is_left_alone_and_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    failing = Failing()
    guarded = Guarded(lambda: failing)
    for step in (1, 2, 3):
        guarded.numbers(step, {"a": 1.0})
        guarded.picture(step, "b", PICTURE)
    guarded.close()
    assert failing.calls == ["numbers 1", "picture", "numbers 2"]
    assert capsys.readouterr().err == "training goes on without its logger: OSError('no space left')\n"


def test_without_its_library_a_call_ends_before_the_first_job(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    set_environment(monkeypatch)
    monkeypatch.setitem(opening.LIBRARIES, "wandb", ("no_such_library",))
    assert run(tmp_path, "logger=wandb") == 2
    assert "logger=wandb needs no_such_library: pip install 'envgs-bench[wandb]'" in capsys.readouterr().err
    assert records(tmp_path) == []


def test_without_a_logger_no_library_is_imported(tmp_path: Path) -> None:
    before = {name for name in sys.modules if name.startswith("envgs_bench.loggers")}
    with logging_of(settings_of(None, tmp_path), tmp_path / "run") as logger:
        assert logger is None
    assert {name for name in sys.modules if name.startswith("envgs_bench.loggers")} == before
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_run_is_the_same_one_with_a_logger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    set_environment(monkeypatch)
    assert run_job_here(tmp_path / "logged", "method=2dgs", "logger=tensorboard", "logger.every=2") == 0
    assert run_job_here(tmp_path / "plain", "method=2dgs") == 0
    logged, plain = (only_folder(tmp_path / name) for name in ("logged", "plain"))
    assert logged.name == plain.name
    (ours,), (theirs,) = records(tmp_path / "logged"), records(tmp_path / "plain")
    assert ours.metrics == theirs.metrics
    assert not (plain / LOGGED).exists()
    events = accumulator.EventAccumulator(str(logged / LOGGED))
    events.Reload()
    assert [event.step for event in events.Scalars("test/psnr")] == [2, 4]
    assert [event.step for event in events.Scalars("training/loss")] == [1, 2, 3, 4]
