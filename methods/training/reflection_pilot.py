"""A pilot run on reflections: what tracing mirrored rays gains by their direction, and not by their number.

A second set of primitives makes any picture better, as texture, whether or not anything reflects: without one,
`diffuse_room` is worse too. So what reflections earn is measured against a control that has as many primitives, as many
rays and the same training, but whose rays leave along the surface's normal: what they see is the same from everywhere.
Where something mirrors, only mirrored rays can explain it. Where nothing does, training gives more weight to the
control's, which move less while normals are still being learned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import torch

from envgs_bench.core import Scene
from envgs_bench.parts import BASE, BETA

from ..method import Method
from .pilot_run import smaller, train_briefly

NEVER = 10**12  # a step that no run has
PLAIN: dict[str, Any] = {  # of a base set that reflects nothing: what `2dgs_tuned` has in the place of EnvGS's
    "warm_up": NEVER,
    "normal_weight": 0.05,
    "mono_weight": 0.0,
    "rotation_lr_final": 1e-3,
    "disturb_every": 0,
}

WARM_UP = 3_000  # steps of a run of 30,000 with the base set alone: 60 of a pilot run
LEAST_WEIGHT = 0.85  # scenes of the tuning suite have 0.95 and more, `diffuse_room` 0.75
LEAST_GAIN = 0.4  # dB; `diffuse_room` has up to 0.3
TINY = 1e-12


@dataclass(frozen=True)
class ReflectionOutcome:
    """What mirrored rays did, against the control's.

    Attributes:
        weight: the mean β of the pictures, × the control's.
        gain: how much nearer to the views they brought what they changed more, in dB.
    """

    weight: float
    gain: float

    @property
    def reflects(self) -> bool:
        """Whether they do what a texture cannot, by either; where a number is none, nothing has been shown."""
        return not (self.weight < LEAST_WEIGHT and self.gain < LEAST_GAIN)

    @property
    def sentence(self) -> str:
        found = (
            f"mirrored rays have {self.weight:.2f} times the weight of rays along the normals and {self.gain:+.2f} dB"
        )
        least = f"something reflects from {LEAST_WEIGHT} or {LEAST_GAIN:+} dB on"
        return f"pilot run before the first step: {found}; {least}" + ("" if self.reflects else ": trained as 2DGS")


def reflection_pilot(scene: Scene, mirrored: Method, control: Method) -> ReflectionOutcome:
    """Train both methods, and compare how they draw the scene's training views.

    The gain is 10·log₁₀(Σ w e' / Σ w e) over all pixels of the views, with the squared errors e of `mirrored` and e' of
    `control`, and w, by how much more its reflection changes the pixel of `mirrored`, 0 where it changes that of
    `control` more: a small mirror is not outvoted by walls.

    Args:
        mirrored, control: new, with the same settings and seed.
    """
    small = replace(scene, train=[smaller(view) for view in scene.train], test=[])
    for method in (mirrored, control):
        train_briefly(method, small)
    sums = torch.zeros(2, 2, dtype=torch.float64)  # of β and of w·e, for either method
    for view in small.train:
        target, drawn = view.rgb(mirrored.device), [method.render(view.camera) for method in (mirrored, control)]
        changed, by_control = ((picture.color - picture.layers[BASE]).abs().mean(dim=-1) for picture in drawn)
        more = (changed - by_control).clamp_min(0)
        for row, picture in enumerate(drawn):
            error = (picture.color.clamp(0, 1) - target).square().mean(dim=-1)
            sums[row] += torch.stack([picture.layers[BETA].mean(), (more * error).sum()]).double().cpu()
    (weight, error), (of_control, error_of_control) = sums.clamp_min(TINY).tolist()
    return ReflectionOutcome(weight / of_control, 10 * math.log10(error_of_control / error))
