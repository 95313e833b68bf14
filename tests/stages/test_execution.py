"""What a run does about missing weights, and about a scene without views."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from fakes.methods import MeanColor, Settings

from envgs_bench.methods.registry import create_method
from envgs_bench.metrics import WeightsUnavailable
from envgs_bench.stages import execution
from envgs_bench.testing import tiny_scene


def test_methods_that_want_it_are_given_the_perceptual_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    def loss(image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        return (image - target).abs().mean()

    monkeypatch.setattr(execution, "make_perceptual_loss", lambda device: loss)
    wants, does_not = create_method("envgs"), MeanColor(Settings())
    without = create_method("envgs", {"perceptual_weight": 0.0})
    for method in (wants, does_not, without):
        execution._offer_perceptual_loss(method)
    assert wants.perceptual is loss
    assert does_not.perceptual is None
    assert without.perceptual is None


def test_without_weights_methods_train_without_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def unavailable(device: torch.device) -> None:
        raise WeightsUnavailable("no weights here")

    monkeypatch.setattr(execution, "make_perceptual_loss", unavailable)
    method = create_method("envgs")
    execution._offer_perceptual_loss(method)
    assert method.perceptual is None
    assert "training without the perceptual loss: no weights here" in capsys.readouterr().err
    execution._offer_perceptual_loss(create_method("2dgs"))  # its weight is 0: nothing is missing
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("kind", ["train", "test"])
def test_a_scene_without_views_is_refused(kind: str) -> None:
    scene = replace(tiny_scene(), **{kind: []})
    with pytest.raises(ValueError, match=r"data set tiny has no (training|test) views: it needs at least two images"):
        execution._check_scene(scene)
