"""Perturbed runs: told apart from their partners by one field, drawn from one cache, refused where impossible."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from fakes.runs import only_folder, records, run_here, run_job_here, set_environment

from envgs_bench.datasets.perturbations.registry import PERTURBATIONS as OF_SCENES
from envgs_bench.methods.envgs import EnvGS
from envgs_bench.methods.settings import make_settings, quickness
from envgs_bench.records import Perturbed
from envgs_bench.runs.identity import run_id
from envgs_bench.settings import RunSettings, SettingsError, parse_settings
from envgs_bench.stages.perturbations import load_run_scene, perturbation_of, perturbed_settings
from envgs_bench.stages.setting_perturbations import PERTURBATIONS as OF_SETTINGS

TOY = {"kind": "toy", "scene": "sky_ball", "width": 32, "height": 24, "views": 17, "supersampling": 1}


def settings(kind: str = "none", severity: int = 1, method: str = "envgs", **changes: Any) -> RunSettings:
    given: dict[str, Any] = {
        "method": {"name": method, "kind": method},
        "dataset": {"name": "tiny", "kind": "fakes.datasets:tiny"},
        "perturb": {"kind": kind, "severity": severity},
        "timing": {"frames": 1, "seconds": 0.01},
        **{"protocol": "envgs", "seed": 0, "steps": 900, "device": "cpu", "timeout_minutes": None},
        **{"runs_dir": "runs", "cache_dir": None, "force": False},
    }
    return parse_settings({**given, **changes})


def test_none_and_severity_0_are_the_unperturbed_run() -> None:
    plain, zero, noisy, noisier = settings(), settings("noise", 0), settings("noise", 1), settings("noise", 2)
    assert plain.perturb is zero.perturb is None
    ids = {run_id(each, "cpu") for each in (plain, zero, noisy, noisier)}
    assert run_id(plain, "cpu") == run_id(zero, "cpu") == run_id(settings(severity=3), "cpu")
    assert len(ids) == 3
    without = settings().model_dump()
    del without["perturb"]
    assert run_id(parse_settings(without), "cpu") == run_id(plain, "cpu")


def test_gates_do_not_tell_runs_apart() -> None:
    gates = {
        **{"psnr_drop_db": 1.0, "region_drop_db": 1.0, "count_factor": 2.0, "memory_factor": 2.0, "time_factor": 2.0},
        **{"baseline": "2dgs", "behind_db": 0.1},
    }
    assert run_id(settings(gates=gates), "cpu") == run_id(settings(), "cpu")
    with pytest.raises(SettingsError, match=r"gates\.psnr_drop_db=-1"):
        settings(gates=gates | {"psnr_drop_db": -1})


def test_kinds_of_scenes_and_of_settings_have_names_of_their_own() -> None:
    assert not set(OF_SCENES) & set(OF_SETTINGS)


@pytest.mark.parametrize(
    ("kind", "severity", "complaint"),
    [
        ("nois", 1, "perturb.kind='nois': expected none, exposure, "),
        ("noise", 4, "perturb.severity=4: noise has severities 1 to 3, and 0 for none"),
    ],
)
def test_what_cannot_be_perturbed_is_refused(kind: str, severity: int, complaint: str) -> None:
    with pytest.raises(SettingsError) as caught:
        perturbation_of(settings(kind, severity))
    assert complaint in str(caught.value)
    with pytest.raises(SettingsError, match="method 2dgs has no setting joint, which the perturbation changes"):
        perturbed_settings(settings("no_joint", method="2dgs"))
    with pytest.raises(SettingsError, match=r"perturb\.severity=-1"):
        settings("noise", -1)


def test_the_scene_is_perturbed_as_it_is_read_and_the_cache_holds_it_unperturbed(tmp_path: Path) -> None:
    given = {"dataset": TOY, "cache_dir": tmp_path}
    noisy = load_run_scene(settings("noise", 2, **given))
    plain = load_run_scene(settings(**given))
    assert len(list(tmp_path.rglob("*.scene"))) == 1
    assert not torch.equal(noisy.train[0].image, plain.train[0].image)
    assert torch.equal(noisy.test[0].image, plain.test[0].image)
    other = load_run_scene(settings("noise", 2, seed=1, **given))
    assert not torch.equal(noisy.train[0].image, other.train[0].image)


@pytest.mark.parametrize(
    ("kind", "severity", "expected"),
    [
        (
            "rates_up",
            1,
            {"position_lr": 3 * 1.6e-4, "position_lr_final": 3 * 1.6e-6, "beta_lr": 0.03, "scale_lr": 0.03},
        ),
        ("rates_down", 2, {"sh_lr": 2.5e-4, "rotation_lr": 1e-4}),
        ("scale_rate_up", 3, {"scale_lr": 0.3}),
        ("size_limit", 3, {"max_primitives": 1000, "env_max_primitives": 1000}),
        ("no_resets", 1, {"opacity_reset_every": 0}),
        ("no_joint", 1, {"joint": False}),
    ],
)
def test_settings_of_a_method_are_perturbed(kind: str, severity: int, expected: dict[str, Any]) -> None:
    given = settings(kind, severity)
    actual = perturbed_settings(given)
    changed = actual.method.settings
    assert {key: changed[key] for key in expected} == pytest.approx(expected)
    assert all(key in expected or key.endswith(("_lr", "_lr_final")) for key in changed)
    assert (actual.steps, actual.dataset) == (given.steps, given.dataset)


@pytest.mark.parametrize(
    ("kind", "severity", "share"),
    [("rates_down", 1, 1 / 3), ("rates_down", 3, 1 / 30), ("rates_up", 3, 1.0), ("scale_rate_up", 3, 1.0)],
)
def test_a_method_is_as_slow_as_most_of_its_rates(kind: str, severity: int, share: float) -> None:
    changed = perturbed_settings(settings(kind, severity)).method.settings
    assert quickness(make_settings(EnvGS.Settings, changed, "envgs")) == pytest.approx(share)


def test_steps_and_sizes_are_perturbed() -> None:
    assert [perturbed_settings(settings("steps_fewer", s)).steps for s in (1, 2, 3)] == [300, 90, 30]
    assert perturbed_settings(settings("steps_more", 1)).steps == 2700
    toy = perturbed_settings(settings("pixels_fewer", 2, dataset=TOY | {"width": 80, "height": 60})).dataset
    assert (toy["width"], toy["height"]) == (40, 30)
    toy = perturbed_settings(settings("pixels_fewer", 2, dataset=TOY)).dataset
    assert (toy["width"], toy["height"]) == (16, 16), "LPIPS is not defined below"
    capture = {"kind": "colmap", "root": "fox", "downsample": 4}
    assert perturbed_settings(settings("pixels_fewer", 3, dataset=capture)).dataset["downsample"] == 10
    assert perturbed_settings(settings("pixels_more", 3, dataset=capture)).dataset["downsample"] == 1


@pytest.mark.slow
def test_a_sweep_leaves_one_partner_and_records_that_differ_in_the_perturbation_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    set_environment(monkeypatch)
    sweep = ("perturb.kind=none,noise,steps_fewer", "perturb.severity=1,2", "steps=6")
    assert run_here(tmp_path, *sweep, flags=("-m",)) == 0
    assert "ok (reused)" in capsys.readouterr().out
    found = records(tmp_path)
    assert sorted((r.perturbation.kind, r.perturbation.severity) for r in found if r.perturbation) == [
        *(("noise", 1), ("noise", 2)),
        *(("steps_fewer", 1), ("steps_fewer", 2)),
    ]
    assert [r.steps for r in found if r.perturbation and r.perturbation.kind == "steps_fewer"] in ([2, 1], [1, 2])
    assert Perturbed(kind="noise", severity=2, level="noise with a σ of 0.05 of the range") in [
        r.perturbation for r in found
    ]
    configs = [{k: v for k, v in r.config.items() if k not in ("perturb", "overrides")} for r in found]
    assert len(found) == 5
    assert all(config == configs[0] for config in configs)
    assert configs[0]["gates"]["baseline"] == "2dgs_tuned"


def test_cases_of_any_list_are_one_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch)
    cases = "perturb={kind:none,severity:0},{kind:points_fewer,severity:3}"
    assert run_here(tmp_path, cases, flags=("-m",)) == 0
    assert [r.perturbation and r.perturbation.kind for r in records(tmp_path)].count("points_fewer") == 1
    assert len(records(tmp_path)) == 2


@pytest.mark.parametrize("override", ["perturb.kind=nois", "perturb.severity=4"])
def test_a_wrong_perturbation_stops_before_anything_runs(
    override: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    set_environment(monkeypatch)
    assert run_here(tmp_path, "perturb.kind=noise", override) == 2
    assert override.replace("nois", "'nois'") in capsys.readouterr().err
    assert records(tmp_path) == []


def test_a_scene_that_lacks_what_is_to_be_perturbed_fails_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_environment(monkeypatch)
    assert run_job_here(tmp_path, "perturb.kind=views", "perturb.severity=1") == 1
    (record,) = records(tmp_path)
    assert record.status == "failed"
    assert record.error is not None
    assert "expected more than 24 to keep 24 of" in record.error.message
    assert record.perturbation is not None
    assert only_folder(tmp_path)
