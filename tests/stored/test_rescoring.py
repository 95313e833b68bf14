"""Rescoring: what a protocol makes of a run's pictures is what it would have made of the run."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from damaged_files import EPS, write_promising_png
from fakes.runs import only_folder, records, run_job_here, set_environment

from envgs_bench.cli.main import main
from envgs_bench.core import Scene
from envgs_bench.metrics import get_protocol
from envgs_bench.records import Failure, read_record, write_record
from envgs_bench.reports import build_report
from envgs_bench.run_folder import read_png
from envgs_bench.settings import RunSettings
from envgs_bench.stages.pictures import save_png
from envgs_bench.stored import rescoring
from envgs_bench.stored.reopening import reopen_scene


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one run under the protocol of floats; not to be changed."""
    folder = tmp_path_factory.mktemp("finished") / "runs"
    with pytest.MonkeyPatch.context() as patch:
        set_environment(patch)
        assert run_job_here(folder) == 0
    return folder


def test_a_protocol_that_rounds_gets_the_runs_own_numbers_to_the_last_digit(tmp_path: Path, finished: Path) -> None:
    assert run_job_here(tmp_path / "direct", "protocol=strict") == 0
    assert main(["rescore", str(finished), "--protocol", "strict", "--out", str(tmp_path / "again")]) == 0
    (direct,), (again,) = records(tmp_path / "direct"), records(tmp_path / "again")
    assert again.metrics == direct.metrics
    assert again.masked == direct.masked
    assert "reflective" in again.masked
    assert again.metrics is not None
    assert "normal_degrees" in again.metrics.mean
    assert again.protocol == direct.protocol


def test_a_folder_without_runs_is_none_to_rescore(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rescore", str(tmp_path), "--protocol", "strict"]) == 1
    shown = capsys.readouterr()
    assert f"{tmp_path}: no record.json under it: give the runs_dir of an `envgs-bench run`" in shown.err
    assert shown.out == ""


def test_records_are_not_written_over_those_that_they_are_made_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], finished: Path
) -> None:
    before = (only_folder(finished) / "record.json").read_bytes()
    for out in (finished, finished.parent):
        assert main(["rescore", str(finished), "--protocol", "strict", "--out", str(out)]) == 1
        assert f"--out {out}: is or holds {finished}, whose records it must not touch" in capsys.readouterr().err
    assert (only_folder(finished) / "record.json").read_bytes() == before


@pytest.mark.parametrize("protocol", ["strict", "inria"])
def test_pictures_and_checkpoints_agree_where_protocols_round(tmp_path: Path, finished: Path, protocol: str) -> None:
    command = ["rescore", str(finished), "--protocol", protocol, "--device", "cpu", "--out"]
    assert main([*command, str(tmp_path / "pictures")]) == 0
    assert main([*command, str(tmp_path / "checkpoints"), "--redraw"]) == 0
    (pictures,), (checkpoints,) = records(tmp_path / "pictures"), records(tmp_path / "checkpoints")
    assert (pictures.metrics, pictures.masked) == (checkpoints.metrics, checkpoints.masked)
    assert pictures.protocol == checkpoints.protocol


def test_a_rescored_record_keeps_the_run_and_leaves_its_folder_alone(tmp_path: Path, finished: Path) -> None:
    folder = only_folder(finished)
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert main(["rescore", str(finished), "--protocol", "strict"]) == 0
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before
    strict = finished.with_name("runs-strict")
    again = strict / folder.relative_to(finished)
    old, new = read_record(folder), read_record(again)
    assert (new.timing, new.cost, new.run_id, new.config) == (old.timing, old.cost, old.run_id, old.config)
    origin = new.provenance.model_dump()["rescored"]
    assert origin["run"] == str(folder)
    assert (origin["protocol"]["name"], origin["from"]) == ("envgs", "pictures")
    report = build_report(strict, tmp_path / "report")
    assert report.sections[0].protocol.name == "strict"
    assert list((tmp_path / "report" / "pictures").rglob("*.png"))  # the run's pictures, through the links


def test_floats_cannot_be_had_from_pictures_and_the_record_says_so(tmp_path: Path, finished: Path) -> None:
    for name, other in (("envgs", "inria"), ("nerfbaselines", None)):
        assert main(["rescore", str(finished), "--protocol", name, "--out", str(tmp_path / name)]) == 0
        (record,) = records(tmp_path / name)
        assert record.protocol.name == f"{name}-8bit"
        assert record.protocol.hash != get_protocol(name).hash
        assert "rounded to 8 bits" in record.protocol.description
        assert other is None or record.protocol.hash == get_protocol(other).hash


@pytest.mark.parametrize("protocol", ["envgs", "nerfbaselines"])
def test_views_drawn_again_get_the_runs_own_numbers_under_every_protocol(
    tmp_path: Path, finished: Path, protocol: str
) -> None:
    out = ("--out", str(tmp_path / "again"), "--device", "cpu")
    assert main(["rescore", str(finished), "--protocol", protocol, "--redraw", *out]) == 0
    (again,), (run_itself,) = records(tmp_path / "again"), records(finished)
    assert again.protocol.name == protocol
    same = (again.metrics, again.masked) == (run_itself.metrics, run_itself.masked)
    assert same == (protocol == "envgs")
    assert again.provenance.model_dump()["rescored"]["from"] == "checkpoint"
    assert (only_folder(tmp_path / "again") / "renders" / "view0.png").is_file()


def test_photographs_that_changed_are_not_drawn_again(
    tmp_path: Path, finished: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A model of other photographs would be scored against these, and stand in a table with models of these."""

    def corrected(folder: Path, settings: RunSettings) -> Scene:
        scene = reopen_scene(folder, settings)
        first, *others = scene.test
        return replace(scene, test=[replace(first, image=255 - first.image), *others])

    monkeypatch.setattr(rescoring, "reopen_scene", corrected)
    command = ["rescore", str(finished), "--protocol", "strict", "--out", str(tmp_path / "again"), "--device", "cpu"]
    assert main([*command, "--redraw"]) == 1
    said = capsys.readouterr().err
    assert "1 of 2 views are other pictures now than those that the run was scored on (view0)" in said
    assert "run it again, or rescore its pictures without --redraw" in said
    assert not (tmp_path / "again").exists()
    assert main(command) == 0


def test_drawing_again_where_pictures_were_linked_leaves_the_run_alone(tmp_path: Path, finished: Path) -> None:
    folder = only_folder(finished)
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    command = ["rescore", str(finished), "--protocol", "strict", "--out", str(tmp_path / "again"), "--device", "cpu"]
    assert main(command) == 0
    assert main([*command, "--redraw"]) == 0
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


def test_saved_pictures_round_as_protocols_do(tmp_path: Path) -> None:
    """At and around every halfway point between two bytes, where roundings differ."""
    halves = (torch.arange(255) + 0.5) / 255
    values = torch.stack([halves, halves.nextafter(torch.ones(1)), halves.nextafter(torch.zeros(1))])
    image = values.reshape(3, 255, 1).repeat(8, 1, 3)
    save_png(tmp_path / "a.png", image)
    strict, target = get_protocol("strict"), torch.zeros_like(image)
    saved = torch.from_numpy(read_png(tmp_path / "a.png")).float() / 255
    assert strict.score(saved, target) == strict.score(image, target)
    assert strict.score(saved, saved)["psnr"] == 100


@pytest.mark.parametrize("reached", [{"metrics": None, "masked": {}, "timing": None}, {"timing": None}], ids=len)
def test_failed_runs_stay_failures(tmp_path: Path, finished: Path, reached: dict[str, None]) -> None:
    shutil.copytree(finished, tmp_path / "runs")
    folder = only_folder(tmp_path / "runs")
    failure = Failure(type="RuntimeError", message="in a bad mood", log_tail="")
    failed = read_record(folder).model_copy(update={"status": "failed", "error": failure, **reached})
    write_record(folder, failed)
    for options in ((), ("--redraw",)):
        assert main(["rescore", str(tmp_path / "runs"), "--protocol", "strict", *options]) == 0
        (record,) = records(tmp_path / "runs-strict")
        assert (record.status, record.error) == ("failed", failure)
        assert record.protocol.name == "strict"


def test_missing_pictures_and_wrong_arguments_are_named(
    tmp_path: Path, finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(finished, tmp_path / "runs")
    assert main(["rescore", str(tmp_path / "runs"), "--protocol", "paper"]) == 1
    assert "unknown protocol 'paper', expected one of envgs, strict" in capsys.readouterr().err
    assert main(["rescore", str(tmp_path / "none"), "--protocol", "strict"]) == 1
    assert "no such folder" in capsys.readouterr().err
    shutil.rmtree(only_folder(tmp_path / "runs") / "targets")
    assert main(["rescore", str(tmp_path / "runs"), "--protocol", "strict"]) == 1
    assert "view0.png: cannot be read" in capsys.readouterr().err


def test_a_run_that_cannot_be_scored_leaves_the_others_scored(
    tmp_path: Path, finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Pictures that promise gigabytes or are none, a pipe, a view that leads out of the folder, a record of lists."""
    names = ("whole", "bomb", "eps", "pipe", "outside", "region", "nested")
    folders = {name: tmp_path / "runs" / name for name in names}
    for folder in folders.values():
        shutil.copytree(only_folder(finished), folder)
    write_promising_png(folders["bomb"] / "renders/view0.png")
    (folders["eps"] / "renders/view0.png").write_bytes(EPS)
    (folders["pipe"] / "targets/view0.png").unlink()
    os.mkfifo(folders["pipe"] / "targets/view0.png")
    content = json.loads((folders["outside"] / "record.json").read_text())
    content["metrics"]["per_view"][0]["view"] = "../../whole/renders/view0"
    (folders["outside"] / "record.json").write_text(json.dumps(content))
    content = json.loads((folders["region"] / "record.json").read_text())
    content["masked"]["../x"] = content["masked"].pop("reflective")
    (folders["region"] / "record.json").write_text(json.dumps(content))
    (folders["nested"] / "record.json").write_text("[" * 50_000)
    assert main(["rescore", str(tmp_path / "runs"), "--protocol", "strict", "--out", str(tmp_path / "again")]) == 1
    said = capsys.readouterr()
    assert said.out.startswith("1 records under protocol strict")
    assert [record.protocol.name for record in records(tmp_path / "again")] == ["strict"]
    reasons = {
        "bomb": "renders/view0.png: cannot be read (Image size (3600000000 pixels) exceeds limit",
        "eps": "renders/view0.png: cannot be read (cannot identify image file",
        "pipe": "targets/view0.png: cannot be read (it is a named pipe, expected a file)",
        "outside": "record.json: names a view or region '../../whole/renders/view0', which no picture is called",
        "region": "record.json: names a view or region '../x', which no picture is called",
        "nested": "record.json: not a record: maximum recursion depth",
    }
    for name, reason in reasons.items():
        assert f"{folders[name]}/{reason}" in said.err
