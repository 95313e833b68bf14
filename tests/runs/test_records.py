"""record.json: validated on write and read, written atomically, and clear about what is wrong with a file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from envgs_bench import records
from envgs_bench.records import (
    Record,
    RecordError,
    RepairOutcome,
    TrainingWarning,
    find_records,
    find_runs,
    read_record,
    write_atomically,
    write_record,
)

PROVENANCE = {
    "version": "0.1.0",
    "commit": None,
    "dirty": None,
    "python": "3.11.7",
    "packages": {"torch": "2.13.0"},
    "machine": {"cpu": "x"},
    "device": {"name": "cpu"},
    "threads": 2,
    "started": "2026-01-01T00:00:00+00:00",
    "finished": "2026-01-01T00:01:00+00:00",
    "command": "envgs-bench run",
}
SCORES = {"psnr": 20.0, "ssim": 0.5, "flip": 0.2, "lpips": None}
CONTENT = {
    "attributes": {},
    "given": [],
    "schema_version": 1,
    "status": "ok",
    "error": None,
    "method": "2dgs",
    "kind": "2dgs",
    "card": None,
    "dataset": "room",
    "data": None,
    "placement": {"shift": [500123.0, -7.0, 0.0], "scale": 0.5},
    "seed": 0,
    "steps": 10,
    "run_id": "seed0-00000000",
    "overrides": ["steps=10"],
    "config": {"steps": 10},
    "protocol": {"name": "envgs", "hash": "12345678", "description": "in words"},
    "scored_on": "test",
    "perturbation": {"kind": "noise", "severity": 2, "level": "much of it"},
    "warnings": [{"kind": "set_shrinks", "step": 7, "part": "base", "message": "from 10 to 4", "times": 1}],
    "notes": ["3 of 9 images are left out"],
    "losses": ["normal", "rgb"],
    "dropped_losses": {"mono": "no normals"},
    "metrics": {
        "mean": SCORES,
        "per_view": [{"view": "a", **SCORES, "normal_degrees": 3.5}],
        "not_computed": {"lpips": "no weights"},
        "cards": {
            "psnr": {
                "title": "PSNR",
                "places": 2,
                "better": "higher",
                "unit": "dB",
                "explanation": "",
                "corrected": False,
            }
        },
        "weights": None,
    },
    "unseen": {
        "between": {
            "mean": SCORES,
            "per_view": [{"view": "a", **SCORES}],
            "not_computed": {},
            "cards": {},
            "weights": None,
        }
    },
    "masked": {"reflective": {**SCORES, "fraction": 0.25, "per_view": [{"view": "a", **SCORES}]}},
    "timing": {
        "frame_ms": 2.0,
        "frame_ms_p95": 3.0,
        "fps": 500.0,
        "prepare_ms": 0.5,
        "height": 4,
        "width": 5,
        "per_view": [{"view": "a", "times_ms": [1.0, 2.0, 3.0]}],
        "contract": "render() to an image on the device",
    },
    "program": None,
    "cost": {
        "primitives": {"base": 10, "env": 0},
        "bytes": {"base": 400, "env": 0},
        "model_bytes": 400,
        "checkpoint_bytes": 500,
        "compact_bytes": 50,
        "train_seconds": 1.5,
        "peak_host_bytes": 1000,
        "peak_device_bytes": None,
        "skipped_steps": 0,
        "peak_primitives": 12,
    },
    "repair": [],
    "repairs": [],
    "provenance": PROVENANCE,
}
LATER = (
    "attributes",
    "given",
    "card",
    "data",
    "placement",
    "scored_on",
    "notes",
    "losses",
    "dropped_losses",
    "perturbation",
    "warnings",
)  # keys
# that older records lack
FAILURE = {"type": "RuntimeError", "message": "why", "log_tail": "…"}


def changed(**changes: object) -> dict:
    return {**CONTENT, **changes}


def without(key: str) -> dict:
    return {name: value for name, value in CONTENT.items() if name != key}


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = write_record(tmp_path, Record.model_validate(CONTENT))
    assert json.loads(path.read_text()) == CONTENT
    older = {key: value for key, value in CONTENT.items() if key not in LATER}
    assert Record.model_validate(older).scored_on == "test"
    assert Record.model_validate(older).dropped_losses == {}
    assert (Record.model_validate(older).perturbation, Record.model_validate(older).warnings) == (None, [])
    scores = {key: value for key, value in CONTENT["metrics"].items() if key != "cards"}
    assert Record.model_validate(CONTENT | {"metrics": scores}).metrics.cards == {}
    cost = {key: value for key, value in CONTENT["cost"].items() if key not in ("checkpoint_bytes", "compact_bytes")}
    unstored = Record.model_validate(CONTENT | {"cost": cost}).cost
    assert (unstored.checkpoint_bytes, unstored.compact_bytes) == (None, None)
    record = read_record(tmp_path)
    assert record == read_record(path)
    assert record.metrics.per_view[0].scores["normal_degrees"] == 3.5
    assert record.masked["reflective"].scores["psnr"] == 20.0


def test_a_failed_run_keeps_the_parts_that_it_reached(tmp_path: Path) -> None:
    write_record(tmp_path, Record.model_validate(changed(status="timeout", error=FAILURE, metrics=None, timing=None)))
    record = read_record(tmp_path)
    assert record.cost.model_bytes == 400
    assert record.dropped_losses == {"mono": "no normals"}
    assert record.metrics is None


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (without("method"), "method: Field required"),
        (changed(surplus=1), "surplus: Extra inputs"),
        (changed(status="splendid"), "status: Input should be"),
        (changed(seed="zero"), "seed: Input should be a valid integer"),
        (changed(metrics=None), "status is ok but metrics is null"),
        (changed(status="failed"), "status is failed but error is null"),
        (changed(schema_version=2), "schema_version is 2, this version of envgs-bench reads 1"),
        (without("schema_version"), "schema_version is None"),
        (changed(cost={"primitives": {}}), "cost.bytes: Field required"),
        ([], "expected a JSON object, found list"),
    ],
)
def test_a_wrong_record_is_refused_by_name(tmp_path: Path, content: object, complaint: str) -> None:
    path = tmp_path / "record.json"
    path.write_text(json.dumps(content))
    with pytest.raises(RecordError) as caught:
        read_record(tmp_path)
    assert complaint in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("length", [0, 1, 100, -3])
def test_a_truncated_record_is_refused_by_name(tmp_path: Path, length: int) -> None:
    path = write_record(tmp_path, Record.model_validate(CONTENT))
    path.write_text(path.read_text()[:length])
    with pytest.raises(RecordError, match=r"record\.json: not valid JSON \(truncated\?\)") as caught:
        read_record(tmp_path)
    assert "force=true" in str(caught.value)


def test_a_record_that_is_no_text_or_not_there(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="cannot be read"):
        read_record(tmp_path)
    (tmp_path / "record.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RecordError, match="cannot be read"):
        read_record(tmp_path)


@pytest.mark.filterwarnings("ignore:Pydantic serializer warnings")
def test_a_record_that_does_not_validate_is_not_written(tmp_path: Path) -> None:
    record = Record.model_construct(**{**Record.model_validate(CONTENT).__dict__, "seed": -0.5})
    with pytest.raises(RecordError, match="not written: seed"):
        write_record(tmp_path, record)
    assert list(tmp_path.iterdir()) == []


def test_a_time_that_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="finite number"):
        Record.model_validate(changed(timing={**CONTENT["timing"], "frame_ms": float("nan")}))


def test_a_write_that_fails_leaves_the_old_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_record(tmp_path, Record.model_validate(CONTENT))

    def full(*_: object) -> None:
        raise OSError("No space left on device")

    monkeypatch.setattr(records.os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_atomically(path, "half")
    assert read_record(path).method == "2dgs"
    assert list(tmp_path.iterdir()) == [path]


def test_records_are_found_in_order(tmp_path: Path) -> None:
    for name in ("b/2", "a/1", "b/1"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "record.json").touch()
    found = [str(path.parent.relative_to(tmp_path)) for path in find_records(tmp_path)]
    assert found == ["a/1", "b/1", "b/2"]
    with pytest.raises(RecordError, match="no such folder"):
        find_records(tmp_path / "nowhere")


def test_a_run_without_a_record_is_a_run_and_runs_do_not_nest(tmp_path: Path) -> None:
    for path in ("a/record.json", "a/old/record.json", "b/config.yaml", "b/log.txt", "c/config.yaml", "d/log.txt"):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).touch()
    assert find_runs(tmp_path) == [tmp_path / "a", tmp_path / "b"]
    assert find_runs(tmp_path / "b") == [tmp_path / "b"]
    assert find_records(tmp_path) == [tmp_path / "a" / "record.json"]


def test_warnings_of_older_records_have_todays_words() -> None:
    older = {"needles": "degenerate", "capped": "size_limit", "loss_climbs": "loss_climbs"}
    read = [TrainingWarning.model_validate({"kind": kind, "step": 1, "part": "", "message": ""}) for kind in older]
    assert [warning.kind for warning in read] == list(older.values())


def test_what_older_records_say_decided_a_repair_is_read() -> None:
    older = {"kind": "exposures", "kept": True, "message": "", "evidence": {"stops": 0.5}}
    assert RepairOutcome.model_validate(older).measured == {"stops": 0.5}
