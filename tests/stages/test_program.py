"""method=external: a program trains and draws by its recipe, and whatever it does there is a record."""

from __future__ import annotations

import json
import shutil
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import torch
from fakes.datasets import tiny
from fakes.recipes import recipe_file
from fakes.runs import only_folder, records, run, run_here, run_job_here, set_environment
from PIL import Image
from torch import Tensor

from envgs_bench.core import rasterize
from envgs_bench.datasets.formats.pictures import read_picture
from envgs_bench.methods.storage.ply import read_gaussians, read_ply, write_ply
from envgs_bench.methods.storage.splats import encode_splats
from envgs_bench.programs import command
from envgs_bench.programs.gaussians import open_gaussians
from envgs_bench.programs.memory import MemoryWatch
from envgs_bench.records import Record
from envgs_bench.reports import build_report
from envgs_bench.run_folder import layer_path
from envgs_bench.stages.pictures import as_bytes
from envgs_bench.stored.reopening import reopen


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


def external(recipe: Path) -> tuple[str, str]:
    return "method=external", f"method.recipe={recipe}"


def outcome(folder: Path, mode: str, *flags: str, **others: Any) -> Record:
    """The record of a run in this process."""
    run_job_here(folder / "runs", *external(recipe_file(folder, mode, *flags, **others)))
    (record,) = records(folder / "runs")
    return record


def test_what_could_be_measured_is_recorded_and_the_rest_is_said(tmp_path: Path) -> None:
    record = outcome(tmp_path, "fine")
    assert (record.status, record.method, record.kind, record.steps) == ("ok", "fake-program", "external", 4)
    assert record.metrics is not None
    assert record.metrics.mean["psnr"] is not None
    assert record.masked["reflective"].scores["psnr"] is not None
    assert record.cost is not None
    assert record.program is not None
    assert record.cost.train_seconds > 0
    assert record.program.own_seconds == pytest.approx(1.5)
    assert record.cost.peak_host_bytes is None or record.cost.peak_host_bytes > 0
    assert (record.cost.primitives, record.cost.model_bytes, record.timing) == ({}, None, None)
    assert "names no file of Gaussians" in record.program.not_measured["frame_ms"]
    assert record.program.commands["train"][0].endswith("4")
    folder = only_folder(tmp_path / "runs")
    assert (folder / "renders" / "view0.png").is_file()
    assert not (folder / "program" / "data").exists()
    color = read_picture(folder / "renders" / "view0.png", (0.0, 0.0, 0.0))[0]
    trained = torch.stack([view.rgb() for view in tiny({"name": "tiny"}, tmp_path).train]).mean((0, 1, 2))
    assert np.abs(color[0, 0] - 255 * trained.numpy()).max() < 0.51


def test_it_stands_beside_ours_in_a_report(tmp_path: Path) -> None:
    assert run_job_here(tmp_path / "runs", *external(recipe_file(tmp_path, "fine"))) == 0
    assert run_job_here(tmp_path / "runs") == 0
    build_report(tmp_path / "runs", tmp_path / "report")
    table = (tmp_path / "report" / "table.md").read_text()
    rows = [line for line in table.splitlines() if line.startswith("| fake-program |")]
    assert rows
    assert not any("nan" in row.lower() for row in rows)


@pytest.mark.parametrize(
    ("mode", "message"),
    [
        ("raises", "RuntimeError: the splats are in a bad mood"),
        ("exits", "ended with exit status 3"),
        ("segfaults", "died of SIGSEGV"),
        ("killed", "was killed (SIGKILL)"),
        ("no-memory", "out of memory"),
        ("nothing", "2 views without a file: view0, view1"),
        ("half", "1 views without a file: view1"),
        ("more", "1 files without a view: 00002.png"),
        ("small", "is 31×24 pixels, its view 32×24"),
        ("beside", "is 64×24 pixels, its view 32×24"),
        ("truncated", "cannot be read"),
        ("nan", "100.0% of its values are not finite"),
    ],
)
def test_every_failure_is_a_record_that_says_why(tmp_path: Path, mode: str, message: str) -> None:
    record = outcome(tmp_path, mode)
    assert record.status == "failed"
    assert record.error is not None
    assert message in record.error.message
    assert record.metrics is None
    assert record.cost is not None
    assert record.cost.train_seconds > 0  # what was measured is kept


def test_pictures_are_matched_by_their_names_below_the_patterns_folder(tmp_path: Path) -> None:
    model_and_pictures(tmp_path / "made", flip=False)
    for number in range(2):
        (tmp_path / "made" / "test" / f"{number}.png").rename(tmp_path / "made" / "test" / f"view{number}.png")
    named = {"files": "{output}/test/*.png", "match": "name"}
    assert outcome(tmp_path, "copies", str(tmp_path / "made"), pictures=named).status == "ok"


def test_pictures_of_other_names_are_named(tmp_path: Path) -> None:
    record = outcome(tmp_path, "fine", pictures={"files": "{output}/test/*", "match": "name"})
    assert record.status == "failed"
    assert record.error is not None
    assert "2 views without a file: view0, view1" in record.error.message
    assert "2 files without a view: 00000.png, 00001.png" in record.error.message


@pytest.mark.parametrize(("mode", "limits"), [("killed", ()), ("greedy", ("memory_gb=0.5",))])
def test_memory_that_ran_out_is_a_status_of_its_own(tmp_path: Path, mode: str, limits: tuple[str, ...]) -> None:
    assert run(tmp_path / "runs", *external(recipe_file(tmp_path, mode)), *limits) == 1
    (record,) = records(tmp_path / "runs")
    assert record.status == "out_of_memory"
    assert record.error is not None
    assert ("memory_gb=0.5" if limits else "SIGKILL") in record.error.message


@pytest.mark.parametrize("mode", ["leaves-child", "floods"])
def test_what_does_no_harm_ends_no_run(tmp_path: Path, mode: str) -> None:
    assert outcome(tmp_path, mode).status == "ok"


def test_a_picture_may_be_a_half_of_its_file(tmp_path: Path) -> None:
    record = outcome(tmp_path, "beside", pictures={"files": "{output}/test/*", "crop": "right half"})
    assert record.status == "ok"
    (tmp_path / "again").mkdir()
    plain = outcome(tmp_path / "again", "fine")
    assert record.metrics is not None
    assert plain.metrics is not None
    assert record.metrics.mean == plain.metrics.mean


def model_and_pictures(folder: Path, flip: bool, layout: str = "ply") -> None:
    """A program's output: pictures that the core draws of Gaussians, and the Gaussians, in other axes where `flip`."""
    scene = tiny({"name": "tiny"}, folder)
    random = torch.Generator().manual_seed(0)
    count = len(scene.points)
    tensors: dict[str, Tensor] = {
        "means": scene.points.float(),
        "quaternions": torch.nn.functional.normalize(torch.randn(count, 4, generator=random), dim=1),
        "log_scales": torch.randn(count, 3, generator=random) / 2 - 2,
        "opacity_logits": torch.full((count,), 2.0),
        "sh_dc": (scene.point_colors.float()[:, None] - 0.5) / 0.282095,
        "sh_rest": torch.randn(count, 3, 3, generator=random) / 10,
    }
    (folder / "test").mkdir(parents=True)
    write_ply(folder / "model.ply", tensors)
    gaussians = read_gaussians(folder / "model.ply")
    for number, view in enumerate(scene.test):
        picture = rasterize(gaussians, view.camera, background=scene.background).color
        Image.fromarray(as_bytes(picture)).save(folder / "test" / f"{number}.png")
    if flip:
        write_ply(folder / "model.ply", {**tensors, "means": tensors["means"] * torch.tensor([1.0, -1, 1])})
    if layout != "ply":
        (folder / "model.ply").unlink()
        (folder / f"model.{layout}").write_bytes(encode_splats(layout, tensors))


def with_model(folder: Path, layout: str = "ply") -> Record:
    return outcome(folder, "copies", str(folder / "made"), model={"file": f"{{output}}/model.{layout}"})


def test_gaussians_that_it_writes_are_drawn_timed_and_held_against_its_pictures(tmp_path: Path) -> None:
    model_and_pictures(tmp_path / "made", flip=False)
    record = with_model(tmp_path)
    assert record.status == "ok"
    assert record.program is not None
    assert record.program.agreement_db is not None
    assert record.program.agreement_db > 55  # rounding to 8 bits alone: 59 dB
    assert record.program.agreement_per_view.keys() == {"view0", "view1"}
    assert record.timing is not None
    assert record.timing.frame_ms > 0
    assert record.cost is not None
    assert record.cost.primitives == {"base": len(tiny({"name": "tiny"}, tmp_path).points), "env": 0}
    folder = only_folder(tmp_path / "runs")
    assert record.cost.checkpoint_bytes == (folder / "checkpoint" / "model.ply").stat().st_size
    assert layer_path(folder, "view0", "core").is_file()
    _, method = reopen(folder, "cpu")
    method.prepare()
    view = tiny({"name": "tiny"}, tmp_path).test[0]
    drawn = as_bytes(method.render(view.camera).color)
    assert np.array_equal(drawn, np.asarray(Image.open(layer_path(folder, "view0", "core"))))


def test_a_program_that_draws_nothing_is_scored_by_what_the_core_draws_of_its_model(tmp_path: Path) -> None:
    """Nor does it see the test views: those of the data are the training ones alone."""
    model_and_pictures(tmp_path / "made", flip=False)
    shutil.rmtree(tmp_path / "made" / "test")
    blind = {"layout": "colmap", "pictures": None, "sees_test_views": False, "model": {"file": "{output}/model.ply"}}
    code = "import os, sys; sys.exit(any('view0' in name for name in os.listdir(sys.argv[1])))"
    look = [f'{sys.executable} -c "{code}" {{data}}/images']
    train = json.loads(recipe_file(tmp_path, "copies", str(tmp_path / "made")).read_text())["train"]
    run_job_here(tmp_path / "runs", *external(recipe_file(tmp_path, "copies", **blind, train=[*look, train])))
    (record,) = records(tmp_path / "runs")
    assert record.status == "ok"
    assert record.program is not None
    assert record.program.agreement_db is None
    assert "draws no test views" in record.program.not_measured["agreement_db"]
    assert record.metrics is not None
    assert record.metrics.mean["psnr"] is not None


def test_its_model_is_aligned_where_cameras_were_moved_and_its_pictures_cannot_be(tmp_path: Path) -> None:
    model_and_pictures(tmp_path / "made", flip=False)
    moved = ("perturb.kind=pose_rotation", "perturb.severity=2")
    blind = {"layout": "colmap", "pictures": None, "sees_test_views": False}
    found = {}
    for name, others in (("drawn", {}), ("blind", blind)):
        recipe = recipe_file(
            tmp_path / name, "copies", str(tmp_path / "made"), model={"file": "{output}/model.ply"}, **others
        )
        assert run_job_here(tmp_path / name / "runs", *external(recipe), *moved) == 0
        (record,) = records(tmp_path / name / "runs")
        assert record.metrics is not None
        found[name] = record.metrics
    assert "psnr_aligned" not in found["drawn"].mean
    assert "cannot be drawn from elsewhere" in found["drawn"].not_computed["psnr_aligned"]
    plain, aligned = (found["blind"].mean[name] for name in ("psnr", "psnr_aligned"))
    assert plain is not None
    assert aligned is not None
    assert aligned >= plain


def test_a_report_prints_the_agreement(tmp_path: Path) -> None:
    model_and_pictures(tmp_path / "made", flip=False)
    with_model(tmp_path)
    build_report(tmp_path / "runs", tmp_path / "report")
    table = (tmp_path / "report" / "table.md").read_text()
    assert "agreement dB" in table
    assert "own train s" in table


def test_other_conventions_show_in_the_agreement(tmp_path: Path) -> None:
    model_and_pictures(tmp_path / "made", flip=True)
    record = with_model(tmp_path)
    assert record.status == "ok"
    assert record.program is not None
    assert record.program.agreement_db is not None
    assert record.program.agreement_db < 30


@pytest.mark.parametrize("layout", ["spz", "sog"])
def test_packed_gaussians_agree_to_their_rounding(tmp_path: Path, layout: str) -> None:
    model_and_pictures(tmp_path / "made", flip=False, layout=layout)
    record = with_model(tmp_path, layout)
    assert record.program is not None
    assert record.program.agreement_db is not None
    assert 35 < record.program.agreement_db < 59


def test_a_model_that_cannot_be_read_costs_the_times_and_not_the_scores(tmp_path: Path) -> None:
    model_and_pictures(tmp_path / "made", flip=False)
    (tmp_path / "made" / "model.ply").write_text("ply of another kind")
    record = with_model(tmp_path)
    assert record.status == "ok"
    assert record.timing is None
    assert record.program is not None
    assert "is no readable PLY" in record.program.not_measured["frame_ms"]


def test_a_program_that_centers_the_principal_point_is_drawn_so(tmp_path: Path) -> None:
    scene = tiny({"name": "tiny"}, tmp_path)
    model_and_pictures(tmp_path / "made", flip=False)
    view, path = scene.test[0], tmp_path / "made" / "model.ply"
    given, centered = (open_gaussians(path, scene, centered=choice) for choice in (False, True))
    moved = view.camera.intrinsics + torch.tensor([[0, 0, 3.0], [0, 0, -2.0], [0, 0, 0]])
    off = replace(view.camera, intrinsics=moved)
    assert torch.equal(centered.render(off).color, given.render(view.camera).color)
    assert torch.equal(centered.picture(off), given.picture(view.camera))
    assert not torch.equal(given.render(off).color, given.render(view.camera).color)


def test_gaussians_that_nobody_can_draw_are_left_out_and_counted(tmp_path: Path) -> None:
    model_and_pictures(tmp_path / "made", flip=False)
    tensors = read_ply(tmp_path / "made" / "model.ply")
    more = {name: torch.cat([values, values[:2]]) for name, values in tensors.items()}
    more["means"][-2, 1] = torch.nan
    more["quaternions"][-1] = 0
    write_ply(tmp_path / "made" / "model.ply", more)
    record = with_model(tmp_path)
    assert record.program is not None
    assert record.program.agreement_db is not None
    assert record.program.agreement_db > 55
    assert record.cost is not None
    count = len(tensors["means"])
    assert record.cost.primitives["base"] == count
    left_out = f"model.ply: 2 of {count + 2} Gaussians have values that are not finite, and are left out"
    assert left_out in record.notes


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "0 files match"),
        (b"\x00\xffno splats", "is no readable PLY"),
        ({"keep": 0, "means": 0.0}, "holds no Gaussian"),
        ({"keep": 3, "means": torch.nan}, "holds no Gaussian of finite values, but 3 others"),
    ],
    ids=["missing", "garbage", "empty", "nowhere"],
)
def test_without_pictures_and_without_a_model_nothing_can_be_scored(
    tmp_path: Path, content: bytes | dict[str, float] | None, message: str
) -> None:
    model_and_pictures(tmp_path / "made", flip=False)
    shutil.rmtree(tmp_path / "made" / "test")
    model = tmp_path / "made" / "model.ply"
    if isinstance(content, dict):
        tensors = {name: values[: int(content["keep"])] for name, values in read_ply(model).items()}
        write_ply(model, {**tensors, "means": tensors["means"] + content["means"]})
    elif content is None:
        model.unlink()
    else:
        model.write_bytes(content)
    blind = {"layout": "colmap", "pictures": None, "sees_test_views": False}
    record = outcome(tmp_path, "copies", str(tmp_path / "made"), **blind, model={"file": "{output}/model.ply"})
    assert record.status == "failed"
    assert record.error is not None
    assert message in record.error.message
    assert record.cost is not None
    assert record.cost.train_seconds > 0


def test_what_was_trained_is_not_trained_again(tmp_path: Path) -> None:
    """The pictures of the first attempt are too few; the second draws again, by another command."""
    draw = "{python} -c 'import sys; sys.exit(3)'"
    recipe = recipe_file(tmp_path, "fine", draw=draw)
    assert run_job_here(tmp_path / "runs", *external(recipe)) == 1
    (folder,) = (tmp_path / "runs" / "tiny" / "fake-program").iterdir()
    assert run_job_here(tmp_path / "runs", *external(recipe), "retry=failed") == 1
    assert (folder / "attempts.txt").read_text().split() == ["4"]
    assert run_job_here(tmp_path / "runs", *external(recipe), "force=true") == 1
    assert (folder / "attempts.txt").read_text().split() == ["4", "4"]


@pytest.mark.parametrize(("resume", "second"), [(None, "4 --once"), ("--resumed", "4 --once --resumed")])
def test_an_interrupted_training_goes_on_where_the_recipe_can(tmp_path: Path, resume: str | None, second: str) -> None:
    others = {}
    if resume:
        others["resume"] = json.loads(recipe_file(tmp_path, "fine", "--once", resume).read_text())["train"]
    recipe = recipe_file(tmp_path, "exits", "--once", **others)
    assert run_job_here(tmp_path / "runs", *external(recipe)) == 1
    assert run_job_here(tmp_path / "runs", *external(recipe), "retry=failed") == 0
    attempts = (only_folder(tmp_path / "runs") / "attempts.txt").read_text().splitlines()
    assert attempts == ["4 --once", second]
    (record,) = records(tmp_path / "runs")
    assert record.program is not None
    assert len(record.program.commands["train"]) == (2 if resume else 1)


def test_ctrl_c_ends_the_program_and_the_same_command_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    recipe = recipe_file(tmp_path, "hangs", "--once")

    def look(watch: MemoryWatch, pid: int | None) -> None:
        """Interrupts once the program and what it started are there."""
        if pid is not None and psutil.Process(pid).children():
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(MemoryWatch, "look", look)
        assert run_here(tmp_path / "runs", *external(recipe)) == 130
    time.sleep(0.2)
    child = int(capfd.readouterr().err.partition("child ")[2].split()[0])
    assert not psutil.pid_exists(child) or psutil.Process(child).status() == psutil.STATUS_ZOMBIE
    assert run_job_here(tmp_path / "runs", *external(recipe)) == 0
    (record,) = records(tmp_path / "runs")
    assert record.status == "ok"
    assert (only_folder(tmp_path / "runs") / "attempts.txt").read_text().splitlines() == 2 * ["4 --once"]


def test_a_time_limit_ends_the_program_and_all_that_it_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Though it turns a deaf ear to SIGTERM."""
    monkeypatch.setattr(command, "GRACE_SECONDS", 0.3)
    recipe = recipe_file(tmp_path, "ignores")
    assert run(tmp_path / "runs", *external(recipe), "timeout_minutes=0.06") == 1
    (record,) = records(tmp_path / "runs")
    assert record.status == "timeout"
    assert record.cost is not None
    assert 0 < record.cost.train_seconds < 30
    log = (only_folder(tmp_path / "runs") / "log.txt").read_text()
    child = int(log.partition("child ")[2].split()[0])
    assert not psutil.pid_exists(child) or psutil.Process(child).status() == psutil.STATUS_ZOMBIE


def test_a_recipe_that_changed_is_another_run_and_a_name_is_not(tmp_path: Path) -> None:
    for flags, others in (((), {}), ((), {"licence": "MIT"}), (("--more",), {})):
        assert run_job_here(tmp_path / "runs", *external(recipe_file(tmp_path, "fine", *flags, **others))) == 0
    assert len(records(tmp_path / "runs")) == 2


def test_wrong_recipes_end_the_call_before_it_leaves_a_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recipe = recipe_file(tmp_path, "fine", layout="ngp")
    assert run_here(tmp_path / "runs", *external(recipe)) == 2
    assert "layout: Input should be 'colmap'" in capsys.readouterr().err
    assert run_here(tmp_path / "runs", "method=external") == 2
    assert "method.recipe is missing: give it as method.recipe=VALUE" in capsys.readouterr().err
    assert run_here(tmp_path / "runs", *external(recipe_file(tmp_path, "fine")), "budget.mb=1") == 2
    assert "trains no model of ours that a budget could limit" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_a_dry_run_lists_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_here(tmp_path / "runs", *external(recipe_file(tmp_path, "fine")), flags=("--dry-run",)) == 0
    assert "fake-program" in capsys.readouterr().out


def test_views_that_validate_are_those_that_it_draws(tmp_path: Path) -> None:
    recipe = recipe_file(tmp_path, "fine")
    assert run_job_here(tmp_path / "runs", *external(recipe), "score_on=validation") == 0
    (record,) = records(tmp_path / "runs")
    assert record.metrics is not None
    scene = replace(tiny({"name": "tiny"}, tmp_path))
    assert {view.view for view in record.metrics.per_view}.isdisjoint({view.name for view in scene.test})
