"""What a run does about missing weights, missing normals, and a scene without views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from fakes.methods import MeanColor, Settings

from envgs_bench.core import Scene
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.methods.registry import create_method
from envgs_bench.metrics import WeightsUnavailable
from envgs_bench.records import RepairOutcome
from envgs_bench.settings import parse_settings
from envgs_bench.stages import cost, execution, loading
from envgs_bench.stages.results import Results
from envgs_bench.stages.training import Training
from envgs_bench.testing import tiny_scene

WITH_PERCEPTUAL = {"perceptual_weight": 0.01}


def test_methods_that_want_it_are_given_the_perceptual_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    def loss(image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        return (image - target).abs().mean()

    monkeypatch.setattr(execution, "make_perceptual_loss", lambda name, device: loss)
    wants, does_not = create_method("envgs", WITH_PERCEPTUAL), MeanColor(Settings())
    without = create_method("envgs", {"perceptual_weight": 0.0})
    for method in (wants, does_not, without):
        execution.offer_perceptual_loss(method)
    assert wants.perceptual == {"features": loss}
    assert does_not.perceptual == {}
    assert without.perceptual == {}


def test_methods_are_given_the_perceptual_loss_that_they_name(monkeypatch: pytest.MonkeyPatch) -> None:
    named: list[str] = []
    monkeypatch.setattr(execution, "make_perceptual_loss", lambda name, device: named.append(name))
    for settings in ({}, {"rules": {"perceptual_loss": "lpips"}}):
        execution.offer_perceptual_loss(create_method("envgs", WITH_PERCEPTUAL | settings))
    assert named == ["features", "lpips"]


def test_methods_that_prune_are_given_lpips(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "make_perceptual_loss", lambda name, device: name)
    prunes, learns, both = (
        create_method("envgs", {"perceptual_weight": weight, "prune_error": error})
        for weight, error in ((0.0, 0.05), (0.01, 0.0), (0.01, 0.05))
    )
    for method in (prunes, learns, both):
        execution.offer_perceptual_loss(method)
    found = [sorted(method.perceptual) for method in (prunes, learns, both)]
    assert found == [["lpips"], ["features"], ["features", "lpips"]]


def test_without_weights_methods_train_without_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def unavailable(name: str, device: torch.device) -> None:
        raise WeightsUnavailable("no weights here")

    monkeypatch.setattr(execution, "make_perceptual_loss", unavailable)
    method = create_method("envgs", WITH_PERCEPTUAL)
    execution.offer_perceptual_loss(method)
    assert method.perceptual == {}
    assert "training without the perceptual loss: no weights here" in capsys.readouterr().err
    assert method.dropped_losses == {"perceptual": "no weights here"}
    plain = create_method("2dgs")  # its weight is 0: nothing is missing
    execution.offer_perceptual_loss(plain)
    assert capsys.readouterr().err == ""
    assert plain.dropped_losses == {}
    lean = create_method("2dgs", {"prune_error": 0.05})  # which loses no loss, and looks at PSNR alone
    execution.offer_perceptual_loss(lean)
    assert (lean.perceptual, lean.dropped_losses) == ({}, {})
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("kind", "settings", "bare", "dropped"),
    [
        ("envgs", {}, 5, {"mono": "the data set has no normals for its training views"}),
        ("envgs", {}, 3, {"mono": "only 2 of 5 training views have normals, and it counts at those alone"}),
        ("envgs", {}, 0, {}),
        ("envgs", {"mono_weight": 0.0}, 5, {}),
        ("2dgs", {}, 5, {}),
        ("2dgs", {"mono_weight": 0.01}, 5, {"mono": "the data set has no normals for its training views"}),
    ],
)
def test_without_normals_methods_say_what_they_train_without(
    kind: str, settings: dict[str, float], bare: int, dropped: dict[str, str], tmp_path: Path
) -> None:
    method = create_method(kind, settings)
    events: list[dict[str, Any]] = []
    Training(method, scene_without_normals(bare), 1, seed=0).run(tmp_path / "curve.csv", events.append)
    assert method.dropped_losses == dropped
    assert [event["dropped_losses"] for event in events[:-1]] == ([dropped] if dropped else [])
    assert "loss" in events[-1]


def test_what_was_trained_without_is_a_result(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ENVGS_BENCH_VGG16", "off")
    results = execute("envgs", WITH_PERCEPTUAL, 1, monkeypatch, tmp_path)
    assert results.metrics is not None
    assert results.losses == ["normal", "opacity", "rgb", "scale"]
    assert results.notes == ["data set tiny has only 5 training views, of which little can be learned"]
    assert "normal_degrees" not in results.metrics.not_computed
    assert results.dropped_losses == {
        "mono": "the data set has no normals for its training views",
        "perceptual": "VGG-16 is switched off by ENVGS_BENCH_VGG16=off",
    }


def test_a_run_that_a_method_ends_sooner_has_the_steps_that_it_trained(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    results = execute("3dgs", {"rules": {"longest_run": 2}}, 5, monkeypatch, tmp_path)
    assert results.steps == 2
    assert (tmp_path / "curve.csv").read_text().splitlines()[-1].startswith("2,")


def test_what_is_wrong_with_a_scene_and_what_was_repaired_are_results(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    scene = tiny_scene()
    at_a_camera = replace(scene, points=scene.train[0].camera.center + 0.01 * scene.points)
    outcome = RepairOutcome(kind="exposures", kept=True, message="other light", measured={"stops": 0.5})
    given: list[tuple[Any, ...]] = []

    def repaired(diagnosis: Diagnosis, *arguments: Any) -> tuple[Diagnosis, list[RepairOutcome]]:
        given.append(arguments)
        return Diagnosis(scene), [outcome]

    monkeypatch.setattr(execution, "repaired", repaired)
    started = []
    monkeypatch.setattr(
        execution, "Training", lambda method, scene, *_: started.append(scene) or Training(method, scene, *_)
    )
    results = execute("2dgs", {}, 1, monkeypatch, tmp_path, at_a_camera, ["normals", "exposures"])
    assert given == [(("exposures", "normals"),)]
    assert started == [scene]
    assert results.repairs == [outcome]
    assert [(warning.kind, warning.step) for warning in results.warnings] == [
        ("run_short", 0),
        ("points_unsupported", 0),
    ]
    assert results.notes[-1] == "repair of exposures: other light"


def test_test_views_without_exact_normals_are_said_to_be(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    scene = replace(tiny_scene(), test=[replace(view, normal=None) for view in tiny_scene().test])
    metrics = execute("2dgs", {}, 1, monkeypatch, tmp_path, scene).metrics
    assert metrics is not None
    assert metrics.mean.get("normal_degrees") is None
    assert metrics.not_computed["normal_degrees"] == "1 of 1 scored views bring no exact normals"


def test_the_cost_is_the_trainings_and_not_that_of_its_scores(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    began = []
    evaluate = execution.evaluate

    def evaluated(*arguments: Any) -> Any:
        began.append(True)
        return evaluate(*arguments)

    monkeypatch.setattr(execution, "evaluate", evaluated)
    monkeypatch.setattr(cost, "peak_device_bytes", lambda device: 9_000 if began else 1_000)
    results = execute("2dgs", {}, 1, monkeypatch, tmp_path)
    assert began
    assert results.cost is not None
    assert results.cost.peak_device_bytes == 1_000
    assert results.cost.checkpoint_bytes == sum(path.stat().st_size for path in (tmp_path / "checkpoint").rglob("*"))


def execute(
    kind: str,
    settings: dict[str, float],
    steps: int,
    monkeypatch: pytest.MonkeyPatch,
    folder: Path,
    scene: Scene | None = None,
    repair: Sequence[str] = (),
) -> Results:
    """What a run has reached, on a tiny scene without normals for training where no other is given."""
    monkeypatch.setattr(loading, "load_run_scene", lambda *_: scene or scene_without_normals(5))
    run = {
        "method": {"name": kind, "kind": kind, "settings": settings},
        "dataset": {"name": "tiny", "kind": "tiny"},
        "timing": {"frames": 1, "seconds": 0.01},
        "repair": repair,
        **{"protocol": "envgs", "seed": 0, "steps": steps, "device": "cpu", "timeout_minutes": None},
        **{"runs_dir": folder, "cache_dir": folder, "force": False},
    }
    results = Results("tiny", steps)
    execution.execute(parse_settings(run), folder, results, lambda event: None)
    return results


def scene_without_normals(bare: int) -> Scene:
    """A scene of five training views, the first `bare` of them without normals."""
    scene = tiny_scene()
    return replace(scene, train=[replace(v, normal=None) for v in scene.train[:bare]] + scene.train[bare:])


def test_views_too_small_for_the_metrics_are_refused_before_training() -> None:
    scene = tiny_scene()
    camera = scene.test[0].camera.resized(15, 16)
    small = replace(
        scene.test[0], camera=camera, image=torch.zeros(16, 15, 3, dtype=torch.uint8), masks={}, normal=None
    )
    with pytest.raises(ValueError, match=r"view .* is 15×16 pixels, expected at least 16×16.*dataset.downsample"):
        execution.check_scene(replace(scene, test=[small]))


@pytest.mark.parametrize("kind", ["train", "test"])
def test_a_scene_without_views_is_refused(kind: str) -> None:
    scene = replace(tiny_scene(), **{kind: []})
    with pytest.raises(ValueError, match=r"data set tiny has no (training|test) views: it needs at least two images"):
        execution.check_scene(scene)
