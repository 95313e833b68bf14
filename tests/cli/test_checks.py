"""What is wrong with a call of `run` is said before its first job, once, and leaves no record."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from fakes.runs import records, run, set_environment

from envgs_bench.cli.checks import checked
from envgs_bench.cli.composition import register_choices
from envgs_bench.cli.main import COMMANDS, main
from envgs_bench.settings import SettingsError

NOT_FOUND = (
    "method 'my_method:Smooth' cannot be imported: No module named 'my_method': it is neither installed nor in a "
    "folder of PYTHONPATH; put PYTHONPATH=. before the command where the file lies in this folder"
)


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["dataset=colmap", "dataset.root=/no/where"], "dataset.root=/no/where: there is no such folder"),
        (["dataset=toy/glass", "dataset.width=2"], "dataset.width=2: Input should be greater than or equal to 16"),
        (
            ["dataset=sampled", "dataset.width=20"],
            "dataset.height=300: expected at most 5 × dataset.width=20; set both",
        ),
        (["method=2dgs", "method.settings.densify_until=1.5e0"], "densify_until is 1.5, expected a valid integer"),
        (["method=2dgs,3dgs", "method.settings.rules.mono_loss=l3"], "rules.mono_loss is 'l3', expected 'cos' or"),
        (["dataset=colmap", "dataset.root=/a(b)"], "'dataset.root=\"/a(b)\"'"),
        (["dataset=colmap", "dataset.root=/a=b"], "'dataset.root=\"/a=b\"'"),
        (["method=renders", "path=/no/where"], "path=/no/where: there is no such folder of renders"),
        (["budget=5"], "budget=5: expected its keys: budget.primitives=, budget.mb=, budget.frame_ms="),
        (["perturb.severity=1,2"], "perturb.severity=1: of nothing, as perturb.kind is none; give one"),
        (["method=my_method:Smooth"], NOT_FOUND),
        (["method.kind=my_method:Smooth"], NOT_FOUND),
        (["method.kind=fakes.methods:Raises,fakes.methods:Nobody"], "has no attribute 'Nobody'"),
        (["method.kind=smooth"], "unknown method 'smooth': the known ones are "),
    ],
)
def test_a_sweep_of_wrong_input_ends_before_it_begins(
    overrides: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path, "seed=0,1", *overrides, flags=("-m",)) == 2
    shown = capsys.readouterr().err
    assert shown.count(message) == 1
    assert shown.startswith("envgs-bench run: ")  # nothing of Hydra's before it
    assert records(tmp_path) == []


def test_a_module_of_ones_own_that_raises_is_said_before_the_first_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "raising_method.py").write_text("raise KeyError('smooth')\n")
    monkeypatch.syspath_prepend(tmp_path)
    for key in ("method", "method.kind"):
        assert run(tmp_path / "runs", f"{key}=raising_method:Smooth") == 2
        shown = capsys.readouterr().err
        assert "'raising_method:Smooth' cannot be imported: its module raises KeyError: 'smooth'" in shown
        assert "there is no method" not in shown
    assert records(tmp_path) == []


def test_every_choice_of_a_sweep_is_looked_at(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, "dataset=tiny,toy/glass,ref_real/sedan", "data_root=/no/where", flags=("-m",)) == 2
    assert "dataset.root=/no/where/ref_real/sedan: there is no such folder. Get it: " in capsys.readouterr().err
    assert records(tmp_path) == []


def test_a_comma_is_a_sweep_or_quoted() -> None:
    register_choices()
    with pytest.raises(SettingsError, match=r"add -m to run each, or quote one value .*: 'method=\"2dgs,3dgs\"'"):
        checked(["method=2dgs,3dgs"])
    with pytest.raises(SettingsError, match="leave -m out, or list the jobs of a sweep with --dry-run"):
        checked(["-m", "method=2dgs,3dgs", "--cfg", "job"])


def test_an_experiment_that_is_a_sweep_is_run_as_one(capsys: pytest.CaptureFixture[str]) -> None:
    register_choices()
    assert checked(["experiment=demo"]) == ["-m", "experiment=demo"]
    assert "experiment=demo is a sweep: running all its jobs, as with -m" in capsys.readouterr().err
    for suite in (["suite=toys"], ["suite=toys", "dataset=toy/glass"]):
        assert checked([*suite, "size=tiny"])[0] == "-m"
        assert "suite=toys is a sweep: running all its jobs, as with -m" in capsys.readouterr().err
    assert checked(["-m", "experiment=demo"]) == ["-m", "experiment=demo"]
    assert checked(["experiment=demo", "method=envgs"]) == ["experiment=demo", "method=envgs"]  # one job is left
    assert checked(["experiment=demo", "--cfg", "job"]) == ["experiment=demo", "--cfg", "job"]


def test_settings_that_a_methods_file_does_not_name_need_no_plus(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "method").mkdir()
    (tmp_path / "method" / "short.yaml").write_text("name: short\nkind: fakes.methods:MeanColor\n")
    register_choices()
    arguments = ["--config-dir", str(tmp_path), "method=short", "method.settings.rate=0.25"]
    assert checked(arguments) == [*arguments[:3], "++method.settings.rate=0.25"]
    with pytest.raises(SettingsError, match=r"method.settings.rats: there is no such setting.*Did you mean 'rate'\?"):
        checked([*arguments[:3], "method.settings.rats=1"])


def test_missing_weights_are_told_of_before_the_first_job(capsys: pytest.CaptureFixture[str]) -> None:
    register_choices()
    checked(["method=2dgs"])
    assert "LPIPS will read n/c, and no perceptual loss is trained with: VGG-16" in capsys.readouterr().err


def test_clean_lists_what_did_not_finish_and_removes_it_when_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from reports_runs import run_folder, write_failure, write_runs

    write_runs(tmp_path, methods=("envgs",), seeds=(0,), pictures=False)
    write_failure(tmp_path, "toy/sky_ball", "2dgs", 3, "failed", "lost")
    write_failure(tmp_path, "toy/sky_ball", "3dgs", 3, "timeout", "late")
    failed, late = (run_folder(tmp_path, "toy/sky_ball", method, 3) for method in ("2dgs", "3dgs"))
    assert main(["clean", str(tmp_path)]) == 0
    assert "1 runs would be removed: add --yes" in capsys.readouterr().out
    assert failed.is_dir()
    assert main(["clean", str(tmp_path), "--yes"]) == 0
    assert not failed.exists()
    assert late.is_dir()
    assert main(["clean", str(tmp_path), "--status", "timeout", "--yes"]) == 0
    assert [path.name for path in (tmp_path / "toy").iterdir()] == ["chrome_room"]


def test_a_report_is_of_the_runs_that_its_patterns_leave(tmp_path: Path) -> None:
    from reports_runs import write_failure, write_runs

    from envgs_bench.reports.numbers.runs import read_runs

    write_runs(tmp_path, ("toy/chrome_room", "toy/sky_ball"), ("envgs", "envmap"), (0, 1), pictures=False)
    write_failure(tmp_path, "toy/sky_ball", "2dgs", 0, "failed", "lost")

    def left(*patterns: list[str]) -> set[tuple[str, str, int]]:
        return {(run.record.dataset, run.record.method, run.record.seed) for run in read_runs(tmp_path, *patterns)[0]}

    assert len(left()) == 9
    assert left(["toy/sky_ball"], ["failed", "*/seed1-*"]) == {
        ("toy/sky_ball", "envgs", 0),
        ("toy/sky_ball", "envmap", 0),
    }
    assert {method for _, method, _ in left(["env*"])} == {"envgs", "envmap"}


def test_the_version_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out.startswith("envgs-bench 0.")


def test_every_method_is_listed_with_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    from envgs_bench.cli.composition import config_names
    from envgs_bench.methods.registry import method_paths
    from envgs_bench.runs.descriptions import described

    assert main(["list", "methods"]) == 0
    shown = capsys.readouterr().out
    assert "EnvGS (Xie et al., CVPR 2025, Sec. 4): surfels, and a second set of them" in shown
    kinds = method_paths()
    assert all(described(name, kinds.get(name, name)).endswith(".") for name in config_names("method"))


def test_a_shell_completes_commands_keys_and_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion"]) == 0
    script = tmp_path / "completion.sh"
    script.write_text(capsys.readouterr().out)
    each = 'for COMP_LINE in "$@"; do COMP_POINT=${#COMP_LINE}; _envgs_bench; echo "${COMPREPLY[*]}"; done'
    lines = ["re", "run see", "run method=envgs_no", "run -m dataset=a,toy/gl"]
    command = ["bash", "-c", f"source {script}; {each}", "bash", *(f"envgs-bench {line}" for line in lines)]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert shown.splitlines() == [
        " ".join(name for name in COMMANDS if name.startswith("re")),
        "seed=",
        "envgs_no_joint",
        "toy/glass",
    ]
