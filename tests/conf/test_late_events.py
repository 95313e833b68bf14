"""No documented method is disturbed, reset, pruned or grown so late in a run that it could not recover."""

from __future__ import annotations

import pytest
import torch

from envgs_bench.cli import composition
from envgs_bench.cli.composition import config_names
from envgs_bench.core import Camera, Scene, View
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.registry import BUILT_IN, create_method

VIEW = View("view", Camera(torch.eye(4), torch.eye(3), 4, 4), torch.zeros(4, 4, 3, dtype=torch.uint8))
SCENE = Scene(
    "points", [VIEW], [VIEW], torch.rand(20, 3, generator=torch.Generator().manual_seed(0)), torch.zeros(20, 3)
)
LEFT = {  # the fewest steps that a run has after each event
    "densify_base": 30,
    "densify_env": 30,
    "begin_prunings": 1,
    "prune": 30,
    "reset_base_opacity": 600,
    "reset_env_opacity": 300,
    "reset_beta": 600,
    "sabotage": 1_000,
    "propagate": 1_000,
    "clear": 600,
    "reset_hiding": 600,
}
LENGTHS = (60, 700, 1_900, 10_000, 29_950, 50_000)
METHODS = sorted({*BUILT_IN, *config_names("method")} - {"renders", "external"})
OF_SCENES = [  # what a release sets apart
    (method, scene)
    for method in ("envgs_released", "3dgs_dr", "ref_gaussian")
    for scene in ("ref_real/sedan", "shiny_blender/helmet")
]


@pytest.mark.parametrize(("name", "scene"), [*((method, "toy/chrome_room") for method in METHODS), *OF_SCENES])
def test_what_happens_late_leaves_a_run_steps_to_recover(name: str, scene: str) -> None:
    chosen = composition.composed([f"method={name}", f"dataset={scene}"]).method
    pilots = {"reflection_pilot": False} if "reflection_pilot" in chosen.settings else {}
    known: set[str] = set()
    happened: set[str] = set()
    for length in LENGTHS:
        method = create_method(chosen.kind, {**chosen.settings, **pilots})
        assert isinstance(method, GaussianMethod)
        steps = method.training_steps(length)
        method.initialize(SCENE, steps)
        for event in method.runner.events:
            known.add(event.name)
            late = range(max(1, steps - LEFT[event.name] + 1), steps + 1)
            assert not [step for step in late if event.due(step, steps)], (event.name, steps)
            if event.name not in happened and any(event.due(step, steps) for step in range(1, late.start)):
                happened.add(event.name)
    assert known == happened


def test_what_is_left_out_is_not_recovered_from() -> None:
    """A reset 100 steps before the end is none, and growth does not pause after it."""
    method = create_method("3dgs_dr", {})
    assert isinstance(method, GaussianMethod)
    method.initialize(SCENE, 700)
    resets = method.model.policies["base"].resets
    assert resets.due(600)
    assert not resets.recovers(650)
    assert "densify_base" in {event.name for event in method.runner.due(660)}
