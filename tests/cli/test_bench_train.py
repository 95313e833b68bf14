"""`envgs-bench bench train`: its clock, its rows, its files, and what it refuses."""

from __future__ import annotations

import csv
import json
import signal
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch
from torch import Tensor

from envgs_bench.bench.course import MethodTraining, Stops, course, mean_psnr
from envgs_bench.bench.train import Contest, Entry, Row, default_steps, entered
from envgs_bench.cli.main import main
from envgs_bench.core import Camera, Scene, View
from envgs_bench.methods.registry import create_method
from envgs_bench.stages.training import Training
from envgs_bench.testing import tiny_scene

TINY = ("dataset=colmap", "dataset.kind=fakes.datasets:tiny", "dataset.root=.", "dataset.name=tiny", "device=cpu")


class Clock:
    """Seconds that pass only where a test says so."""

    def __init__(self) -> None:
        self.now = 1000.0

    def perf_counter(self) -> float:
        return self.now


class Pupil:
    """Takes 3 seconds to begin, 2 a step, and half a second to finish steps that are under way."""

    def __init__(self, clock: Clock) -> None:
        self.clock, self.seen = clock, []

    def __len__(self) -> int:
        return len(self.seen)

    def start(self, scene: Scene, steps: int) -> None:
        self.clock.now += 3

    def training_step(self, view: View, step: int) -> None:
        self.clock.now += 2
        self.seen.append((view.name, step))

    def settle(self) -> None:
        self.clock.now += 0.5

    def picture(self, camera: Camera) -> Tensor:
        return torch.zeros(camera.height, camera.width, 3)


def test_the_clock_stands_still_at_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr("envgs_bench.bench.course.time", clock)
    pupil, at = Pupil(clock), []
    for stop in course(pupil, tiny_scene(), 10, 0, "cpu", Stops(steps=[2, 3], seconds=[1, 16])):
        at.append(stop)
        clock.now += 100  # looking
    assert at == [(1, 5.5), (2, 8), (3, 10.5), (6, 17), (10, 25.5)]
    assert [step for _, step in pupil.seen] == list(range(1, 11))


def test_a_course_trains_what_a_run_does(tmp_path: Path) -> None:
    """Bit for bit, whoever looks on the way."""
    scene, steps = tiny_scene(), 6
    methods = [create_method("2dgs", {}, "cpu", 0) for _ in range(2)]
    trainee = MethodTraining(methods[0])
    for _ in course(trainee, scene, steps, 0, "cpu", Stops([3])):
        mean_psnr(trainee.picture, scene.test, "cpu")
    Training(methods[1], scene, steps, 0).run(tmp_path / "curve.csv", lambda event: None)
    ours, theirs = (method.model.sets["base"].parameters.tensors for method in methods)
    assert all(torch.equal(ours[name], theirs[name]) for name in theirs)


def test_psnr_is_the_mean_over_views() -> None:
    """Black pictures against views of one gray each: −20·log10 of the gray."""
    camera = Camera(torch.eye(4), torch.eye(3), 4, 3)
    views = [View(str(gray), camera, torch.full((3, 4, 3), gray, dtype=torch.uint8)) for gray in (255, 51)]
    black = torch.zeros(3, 4, 3)
    assert mean_psnr(lambda camera: black - 1, views, "cpu") == pytest.approx((0 + 13.9794) / 2, abs=1e-4)


def test_stops_lie_closer_where_more_is_learned() -> None:
    assert default_steps(3200) == [100, 200, 400, 800, 1600, 2400]
    assert default_steps(1) == [1]


def test_rows_are_printed_written_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = {kind: tmp_path / "new" / f"rows.{kind}" for kind in ("json", "csv")}
    chart = tmp_path / "chart.png"
    arguments = ["bench", "train", *TINY, "method=2dgs,3dgs", "steps=4", "score_on=test", "--at-steps", "2"]
    assert main([*arguments, *(f"--{kind}={path}" for kind, path in files.items()), f"--chart={chart}"]) == 0
    rows = json.loads(files["json"].read_text())
    assert [(row["method"], row["step"]) for row in rows] == [("2dgs", 2), ("2dgs", 4), ("3dgs", 2), ("3dgs", 4)]
    for row in rows:
        assert (row["by"], row["dataset"], row["scored_on"], row["views"]) == ("envgs-bench", "tiny", "test", 2)
        assert row["primitives"] == 200
        assert row["peak_bytes"] is None  # of a GPU
        assert 5 < row["psnr"] < 40
    assert rows[0]["seconds"] < rows[1]["seconds"]
    with files["csv"].open() as stream:
        table = list(csv.DictReader(stream))
    assert [float(row["psnr"]) for row in table] == [row["psnr"] for row in rows]
    assert chart.read_bytes().startswith(b"\x89PNG")
    assert "PSNR of 2 test views, cpu" in capsys.readouterr().out


def test_stops_before_an_interruption_are_printed_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def entered_or_signal(entry: Entry, contest: Contest) -> Iterator[Row]:
        yield from entered(entry, contest)
        signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr("envgs_bench.bench.train.entered", entered_or_signal)
    file = tmp_path / "rows.csv"
    assert main(["bench", "train", *TINY, "method=2dgs,3dgs", "steps=2", "--at-steps", "1", f"--csv={file}"]) == 130
    with file.open() as stream:
        assert [(row["method"], row["step"]) for row in csv.DictReader(stream)] == [("2dgs", "1"), ("2dgs", "2")]
    printed = capsys.readouterr()
    assert "PSNR of" in printed.out
    assert "interrupted after 2 stops" in printed.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["dataset.kind=fakes.datasets:tiny_elsewhere"],
            "dataset.validation=true: elsewhere has 1 for training and validation, expected at least two",
        ),
        (["method=renders", "path=."], "method=renders: another program drew its pictures"),
        (["method=nothing"], "there is no method 'nothing'"),
        (["--gsplat", "2dgs,4dgs"], "--gsplat 4dgs: expected some of 3dgs, 2dgs, 3dgs_mcmc"),
        pytest.param(
            ["--gsplat", "3dgs"],
            "--gsplat: gsplat cannot be imported",
            marks=pytest.mark.skipif(find_spec("gsplat") is not None, reason="gsplat is installed"),
        ),
    ],
)
def test_what_cannot_be_trained_is_refused(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "train", *TINY, *arguments]) == 1
    assert f"envgs-bench bench train: {message}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--at-seconds", "10,soon"], "'10,soon': expected numbers above 0"),
        (["--at-steps", "0"], "'0': expected numbers above 0"),
        (["--csv", "rows.txt"], "--csv rows.txt: expected a file whose name ends in .csv"),
    ],
)
def test_bad_arguments_are_explained(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", "train", *arguments])
    assert ended.value.code == 2
    assert message in capsys.readouterr().err
