"""check_method finds what a method gets wrong, and passes those that are right."""

from __future__ import annotations

from typing import Any

import pytest

from envgs_bench.testing import check_method


def test_a_method_that_conforms_passes() -> None:
    check_method("fakes.methods:MeanColor", {"rate": 0.25})


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        ("2dgs", {}),
        ("3dgs", {}),
        ("envmap", {"envmap_size": 16}),
        ("envgs", {"env_grid": 4}),
        ("envgs", {"env_grid": 4, "warm_up": 9_000, "rules": {"traced_background": "map"}}),
        ("envgs_single_set", {}),
        ("envgs_single_set", {"warm_up": 9_000, "rules": {"traced_background": "map"}}),
        ("3dgs_dr", {"envmap_size": 16}),
        ("ref_gaussian", {"envmap_size": 16}),
        ("gaussian_shader", {"envmap_size": 16}),
        ("ref_gs", {"map_levels": 4}),
        ("ref_gs", {"map_levels": 4, "near_set": True, "scope_radius": 0.5}),
        ("rt_splatting", {"map_levels": 4, "perceptual_weight": 0.0}),
        ("3igs", {"field_size": 8}),
    ],
)
def test_the_built_in_methods_pass(kind: str, settings: dict[str, Any]) -> None:
    check_method(kind, settings, steps=10)


@pytest.mark.parametrize(
    ("kind", "problem"),
    [
        ("methods:Forgets", "a loaded checkpoint does not render as what was saved"),
        ("methods:IsRandom", "the same seed does not train to the same picture"),
        ("methods:NamesNoTotal", "expected the total as 'loss'"),
        ("methods:LosesItsLoss", "loss 'loss' is nan in step 1"),
        ("methods:RendersNaN", "color is not finite everywhere"),
        ("breaches:CanBeChanged", "Settings is not frozen"),
        ("breaches:LosesASet", "primitives() has keys ['base'], expected ['base', 'env']"),
        ("breaches:NamesAnotherSet", "primitives() has keys ['base', 'environment'], expected ['base', 'env']"),
        ("breaches:WeighsOtherSets", "model_bytes() has keys ['base'], expected ['base', 'env']"),
        ("breaches:WeighsNothing", "model_bytes() is 0"),
        ("breaches:ReturnsWholeLosses", "expected a float or a tensor of one value"),
        ("breaches:AnnouncesSkips", "skipped_steps is 8 though every loss was finite"),
        ("breaches:AppliesNaN", "a step whose loss is not finite was applied"),
        ("breaches:CountsNoSkips", "skipped_steps is 0 after a step whose loss was not finite, expected 1"),
        ("breaches:IgnoresItsPerceptualLoss", "needs a perceptual loss, but no training step calls it"),
        ("breaches:NeedsPreparing", "another prepare() changes the picture"),
        ("breaches:RendersGradients", "color carries gradients"),
        ("breaches:RendersHalf", "depth has shape (12, 16), expected (24, 32)"),
        ("breaches:RendersDoubles", "alpha is torch.float64, expected torch.float32"),
        ("breaches:TakesTheHarnesssLayer", "a layer is called 'normal', which the harness adds"),
        ("breaches:DrawsHalfALayer", "layer 'beta' has shape (12, 32)"),
        ("breaches:DrawsLayersOfNaN", "layer 'beta' is not finite everywhere"),
        ("breaches:LoadsAnything", "load() of an empty folder raises neither"),
        ("breaches:ForgetsItsTraining", "an interrupted training does not end where it would have"),
        ("breaches:ExceedsItsBudget", "101 primitives after step 0, of a budget of 100"),
        ("breaches:ForgetsItsCount", "primitives() is {'base': 2, 'env': 0} after load()"),
    ],
)
def test_each_breach_of_the_contract_is_named(kind: str, problem: str) -> None:
    with pytest.raises(AssertionError) as caught:
        check_method(f"fakes.{kind}")
    assert problem in str(caught.value)
