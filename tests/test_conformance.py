"""check_method finds what a method gets wrong, and passes those that are right."""

from __future__ import annotations

from typing import Any

import pytest

from envgs_bench.testing import check_method


def test_a_method_that_conforms_passes() -> None:
    check_method("fakes.methods:MeanColor", {"rate": 0.25})


@pytest.mark.parametrize(
    ("kind", "settings"),
    [("2dgs", {}), ("3dgs", {}), ("envmap", {"envmap_size": 16}), ("envgs", {"env_grid": 4}), ("envgs_single_set", {})],
)
def test_the_built_in_methods_pass(kind: str, settings: dict[str, Any]) -> None:
    check_method(kind, settings, steps=20)


@pytest.mark.parametrize(
    ("kind", "problem"),
    [
        ("Forgets", "a loaded checkpoint does not render as what was saved"),
        ("IsRandom", "the same seed does not train to the same picture"),
        ("NamesNoTotal", "expected the total as 'loss'"),
        ("LosesItsLoss", "loss 'loss' is nan in step 1"),
        ("RendersNaN", "color is not finite everywhere"),
    ],
)
def test_a_method_that_does_not_is_told_in_what(kind: str, problem: str) -> None:
    with pytest.raises(AssertionError) as caught:
        check_method(f"fakes.methods:{kind}")
    assert problem in str(caught.value)
