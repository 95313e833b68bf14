"""Each guard of a training on and off, on a case that it is for: what the run becomes with it, and what without.

As a script it prints the table of docs/notebook/2026-11-22-guards.md:
PYTHONPATH=tests/support python tests/stages/test_guards.py
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from rules import with_rules
from torch_threads import torch_threads
from toy_scenes import coarse_toys
from tuned_baselines import TUNED

from envgs_bench.core import Scene
from envgs_bench.datasets import load_scene
from envgs_bench.methods.gaussian_method import GaussianMethod
from envgs_bench.methods.registry import create_method
from envgs_bench.methods.training import step_runner
from envgs_bench.stages import health
from envgs_bench.stages.health import Diverged, Health
from envgs_bench.stages.training import Training
from envgs_bench.testing import NotFinite

Patch = Callable[[pytest.MonkeyPatch], None]
TOY = {"kind": "toy", "scene": "chrome_room", "views": 17, "supersampling": 1, "normal_noise": 5.0}


@dataclass(frozen=True)
class Ending:
    """How a run of a case ended."""

    status: str  # ok, diverged, or the name of an exception
    step: int
    psnr: float  # mean over test views; NaN where there is none
    warnings: tuple[str, ...]
    primitives: int
    seconds: float


@dataclass(frozen=True)
class Case:
    """Something that goes wrong, and the guard that it is for.

    Attributes:
        spoils: what goes wrong in the scene.
        breaks: what goes wrong in the method.
        off: takes the guard away.
    """

    steps: int
    off: Patch
    width: int = 40
    settings: dict[str, Any] | None = None
    without: dict[str, Any] | None = None  # settings that are the guard's being off
    spoils: Callable[[Scene], Scene] = lambda scene: scene
    breaks: Callable[[GaussianMethod], None] = lambda method: None


def spoil(count: int) -> Callable[[Scene], Scene]:
    """The first training views have pictures that are not finite."""
    return lambda scene: replace(scene, train=[NotFinite(**vars(v)) for v in scene.train[:count]] + scene.train[count:])


def break_gradient(rows: int) -> Callable[[GaussianMethod], None]:
    """At step 40 the gradient of the first positions is NaN."""

    def breaks(method: GaussianMethod) -> None:
        rates = method.model.set_learning_rates

        def at_step(step: int) -> None:
            rates(step)
            if step == 40:
                means = method.model.sets["base"].parameters.tensors["means"]
                spoiled = torch.zeros_like(means)
                spoiled[:rows] = math.nan
                handle = means.register_hook(lambda gradient: (handle.remove(), gradient + spoiled)[1])

        method.model.set_learning_rates = at_step  # type: ignore[method-assign]

    return breaks


def empty_pictures(method: GaussianMethod) -> None:
    """From step 300 on the loss wants empty pictures."""
    losses = method.losses
    method.losses = lambda rendering, target, view, step: (  # type: ignore[method-assign]
        losses(rendering, target, view, step) | ({"wrong": 30 * rendering.alpha.mean()} if step > 300 else {})
    )


def climb(method: GaussianMethod) -> None:
    """From step 1,500 on the steps go up the loss."""
    losses = method.losses
    method.losses = lambda rendering, target, view, step: (  # type: ignore[method-assign]
        {name: -term if step > 1500 else term for name, term in losses(rendering, target, view, step).items()}
    )


def apply_all_steps(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(step_runner, "all_finite", lambda magnitudes: torch.tensor(True))


def never_end(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(health, "NON_FINITE_STEPS", 10**9)
    patch.setattr(Health, "read", lambda self, step, losses: (float(losses["loss"]), math.nan))
    patch.setattr(Health, "count_skips", lambda self, step, steps: None)


def never_count(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Health, "count", lambda self, step, counts: None)


def never_look(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Health, "look", lambda self, step, view: None)


def take_all_away(patch: pytest.MonkeyPatch) -> None:
    for off in (apply_all_steps, never_end, never_count, never_look):
        off(patch)


def limit_nothing(patch: pytest.MonkeyPatch) -> None:
    """The guard is a setting."""


RATES = ("position_lr", "position_lr_final", "sh_lr", "opacity_lr", "scale_lr", "rotation_lr", "rotation_lr_final")
FAST = {key: 30 * getattr(create_method("2dgs", TUNED).settings, key) for key in RATES}
EMPTY = 7.5  # dB, hardly less than pictures of nothing but the background have
STILL = {"densify_until": 0}  # or pruning ends the run before it is looked at
BY_GRADIENT = {"growth": "gradient"}  # guided growth neither empties nor doubles a set, and holds scales by a loss
GREEDY = with_rules(
    growth="gradient",
    **{"densify_threshold": 1e-9, "min_coverage": 0.0, "min_views": 0.0},
    primitives_per_pixel=0.0,
)
UNBOUNDED = {"rules": GREEDY["rules"] | {"max_growth": 0.0}}
HEALTHY = "nothing is wrong"
CASES = {
    HEALTHY: Case(150, take_all_away),
    "one view of 14 is not finite": Case(150, apply_all_steps, spoils=spoil(1)),
    "one view of 14 is not finite, growth by gradients": Case(
        150, apply_all_steps, spoils=spoil(1), settings={"rules": BY_GRADIENT}
    ),
    "one primitive's gradient is not finite, once": Case(150, apply_all_steps, breaks=break_gradient(1)),
    "a whole gradient is not finite, once": Case(150, apply_all_steps, breaks=break_gradient(10**9)),
    "no view is finite": Case(150, never_end, spoils=spoil(99)),
    "a densification prunes all": Case(150, never_count, settings={"min_opacity": 1.1, "rules": BY_GRADIENT}),
    "all learning rates × 30": Case(6000, never_look, width=16, settings=FAST),
    "all learning rates × 30, growth by gradients": Case(
        6000, never_look, width=16, settings=FAST | {"rules": BY_GRADIENT}
    ),
    "the scales learn 30 times as fast": Case(
        300, never_look, settings={"scale_lr": FAST["scale_lr"], "rules": BY_GRADIENT}
    ),
    "the steps go up the loss": Case(6000, never_look, width=16, settings=STILL, breaks=climb),
    "the loss empties the pictures": Case(6000, never_look, width=16, settings=STILL, breaks=empty_pictures),
    "everything is to be split": Case(150, limit_nothing, settings=GREEDY, without=UNBOUNDED),
}


def ending(case: Case, scene: Scene, folder: Path, extra: dict[str, Any] | None = None) -> Ending:
    method = create_method("2dgs", {**TUNED, **(case.settings or {}), **(extra or {})})
    assert isinstance(method, GaussianMethod)
    case.breaks(method)
    training = Training(method, case.spoils(scene), case.steps, seed=0)
    began, status, psnr = time.process_time(), "ok", math.nan
    try:
        training.run(folder / "curve.csv", lambda event: None)
        pictures = [method.render(view.camera).color for view in scene.test]
        if all(picture.isfinite().all() for picture in pictures):
            errors = [
                (picture.clamp(0, 1) - view.rgb()).square().mean()
                for picture, view in zip(pictures, scene.test, strict=True)
            ]
            psnr = float(np.mean([-10 * math.log10(float(error)) for error in errors]))
        else:
            status = "diverged when drawn"
    except Diverged:
        status = "diverged"
    except Exception as error:  # what becomes of a run without its guard is not known
        status = type(error).__name__
    warnings = tuple(warning.kind for warning in training.health.warnings)
    return Ending(status, training.step, psnr, warnings, training.peak_primitives, time.process_time() - began)


def both(case: Case, folder: Path) -> tuple[Ending, Ending]:
    """The ending with the guard, and that without."""
    with coarse_toys():
        scene = load_scene({**TOY, "width": case.width, "height": case.width * 3 // 4}, folder)
    guarded = ending(case, scene, folder)
    with pytest.MonkeyPatch.context() as patch:
        case.off(patch)
        return guarded, ending(case, scene, folder, case.without)


WORTH: dict[str, Callable[[Ending, Ending], bool]] = {  # what a guard changes: its run, and that without it
    HEALTHY: lambda on, off: replace(on, seconds=0) == replace(off, seconds=0) and not on.warnings,
    "one view of 14 is not finite": lambda on, off: (
        on.psnr > EMPTY + 4.5 and (on.status, off.status) == ("ok", "diverged")  # by losses of the set itself
    ),
    "one view of 14 is not finite, growth by gradients": lambda on, off: on.psnr > off.psnr + 3,
    "one primitive's gradient is not finite, once": lambda on, off: bool(on.warnings) and not off.warnings,
    "a whole gradient is not finite, once": lambda on, off: on.psnr > off.psnr + 4 and not off.warnings,
    "no view is finite": lambda on, off: (on.status, on.step, off.status) == ("diverged", 20, "ok"),
    "a densification prunes all": lambda on, off: (on.status, on.step, off.status) == ("diverged", 30, "ok"),
    "all learning rates × 30": lambda on, off: (
        "learns_nothing" in on.warnings and (on.status, off.status) == ("diverged", "ok") and off.psnr < EMPTY + 2
    ),
    "all learning rates × 30, growth by gradients": lambda on, off: (
        "learns_nothing" in on.warnings and on.psnr == off.psnr
    ),
    "the scales learn 30 times as fast": lambda on, off: on.warnings == ("degenerate",) and on.psnr == off.psnr,
    "the steps go up the loss": lambda on, off: (
        "loss_climbs" in on.warnings and on.step < off.step and off.psnr < EMPTY
    ),
    "the loss empties the pictures": lambda on, off: "alpha_vanishes" in on.warnings and on.step < off.step,
    "everything is to be split": lambda on, off: off.primitives > 2 * on.primitives,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_guard_changes_what_it_is_for(name: str, tmp_path: Path) -> None:
    with torch_threads(1):
        on, off = both(CASES[name], tmp_path)
    assert WORTH[name](on, off), (on, off)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, torch_threads(1):
        for name, case in CASES.items():
            for words, found in zip(("with", "without"), both(case, Path(folder)), strict=True):
                print(f"{name} | {words} | {found}", flush=True)


if __name__ == "__main__":
    main()
