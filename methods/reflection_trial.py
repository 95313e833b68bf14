"""A trial of reflections: what a method that traces mirrored rays explains by their direction, and not by their number.

A second set of primitives makes any picture better, as texture, whether or not anything reflects: trained without it,
`diffuse_room` is worse too. So what reflections earn is measured against a control that has as many primitives, as many
rays and the same training, whose rays leave along the surface's normal, so that what they see is the same from
everywhere. Where something mirrors, only the mirrored rays can explain it; where nothing does, the control's are better,
since its rays move less while normals are still being learned.

Both are trained from the start, for as many steps whatever the run's length, on the run's training views made small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Scene, View
from envgs_bench.core.vectors import unit
from envgs_bench.parts import BASE

from .method import Method

NEVER = 10**12  # a step that no run has
PLAIN = {  # what `2dgs_tuned` has in the place of EnvGS's settings: how a set grows and learns that reflects nothing
    "bootstrap": NEVER,
    "densify_every": 100,
    "densify_until": 15_000,
    "min_coverage": 1.0,
    "pixels_per_primitive": 0.0,
    "normal_weight": 0.05,
    "mono_weight": 0.0,
    "rotation_lr_final": 1e-3,
    "disturb_every": 0,
    "prune_from": 14_000,  # `2dgs_lean`'s
}

SCHEDULE = 600  # steps of the run whose beginning a trial is
STEPS = 200  # that it takes: 60 without reflections, and 140 with
PIXELS = 7_000  # of a view, at most
SHORTEST_RUN = 2_000  # steps of a run that can afford a trial
LEAST_GAIN = 0.1  # dB


@dataclass(frozen=True)
class TrialOutcome:
    gain: float  # what `reflection_gain` returned

    @property
    def reflects(self) -> bool:
        return self.gain >= LEAST_GAIN

    @property
    def sentence(self) -> str:
        found = f"{self.gain:+.2f} dB of what mirrored rays change is theirs, of at least {LEAST_GAIN:+.2f} where something"
        return f"in a trial before the first step {found} reflects" + ("" if self.reflects else ": trained as 2DGS")


def reflection_gain(scene: Scene, mirrored: Method, control: Method) -> float:
    """How much nearer to the scene's training views mirrored rays bring a picture than the control's, in dB.

    10·log₁₀(Σ w e' / Σ w e) over all pixels of the views, with the squared errors e of `mirrored` and e' of `control`,
    and w, how much its reflections change the pixel of `mirrored`: a small mirror is not outvoted by the walls.

    Args:
        mirrored, control: new, with the same settings and seed; both are trained here.
    """
    small = replace(scene, train=[smaller(view) for view in scene.train], test=[])
    for method in (mirrored, control):
        _train(method, small)
    weighted = torch.zeros(2, dtype=torch.float64)
    for view in small.train:
        shown = mirrored.render(view.camera)
        weight = (shown.color - shown.layers[BASE]).abs().mean(dim=-1)
        target = view.rgb(mirrored.device)
        for index, color in enumerate((shown.color, control.render(view.camera).color)):
            weighted[index] += float((weight * (color.clamp(0, 1) - target).square().mean(dim=-1)).sum())
    error, of_control = weighted.tolist()
    return 10 * math.log10(of_control / error) if error > 0 and of_control > 0 else 0.0


def smaller(view: View) -> View:
    """The view with at most PIXELS pixels, by area averaging, of what training reads of it."""
    shrink = math.sqrt(PIXELS / (view.camera.width * view.camera.height))
    if shrink >= 1:
        return view
    width, height = (max(1, int(shrink * size)) for size in (view.camera.width, view.camera.height))

    def averaged(pixels: Tensor) -> Tensor:
        return functional.interpolate(pixels.movedim(2, 0)[None], (height, width), mode="area")[0].movedim(0, 2)

    image = averaged(view.rgb() * 255).round().to(torch.uint8)
    normal = None if view.normal is None else unit(averaged(view.normal.float()))
    camera = view.camera.resized(width, height)
    return View(view.name, camera, image, normal=normal)


def _train(method: Method, scene: Scene) -> None:
    method.initialize(scene, SCHEDULE)
    order = torch.Generator().manual_seed(0)
    rows: list[int] = []
    for step in range(1, STEPS + 1):
        if not rows:
            rows = torch.randperm(len(scene.train), generator=order).tolist()
        method.training_step(scene.train[rows.pop()], step)
    method.settle()
    method.prepare()
