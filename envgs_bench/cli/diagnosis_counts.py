"""What diagnosis says of a scene in order, and of the same spoiled on purpose."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

from envgs_bench.core import Scene
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.diagnosis.repair import REPAIRS, repaired
from envgs_bench.diagnosis.scene_warnings import scene_warnings

PLENTY = 10**6  # steps, so that no scene's training is too short
DIGITS = 4
MEASURED: dict[str, Callable[[Diagnosis], float]] = {  # what thresholds are compared with
    "stops": lambda found: found.exposures.stops,
    "pose_gain": lambda found: found.alignment.gain,
    "photo_consistency": lambda found: found.photo_consistency,
    "coverage": lambda found: found.coverage,
    "mirror_gain": lambda found: found.mirrored.gain,
    "normal_disagreement": lambda found: found.disagreement,
    "noise": lambda found: found.photographs.noise,
    "detail": lambda found: found.photographs.detail,
    "blockiness": lambda found: found.photographs.blockiness,
}
COMPARED = {
    "": tuple(MEASURED),
    "exposure": ("stops",),
    "pose_rotation": ("pose_gain",),
    "normals_mirrored": ("mirror_gain",),
}
SPOILED = (  # what, and how severely
    *(("exposure", severity) for severity in (2, 3)),
    ("pose_rotation", 3),
    *(("normals_mirrored", severity) for severity in (1, 2, 3)),
)


def counted(scene: Scene, seed: int, device: torch.device | str = "cpu") -> list[dict[str, Any]]:
    """A row for the scene in order, of `spoiled` "", and one for each way in which it is spoiled.

    What is `warned` of and `repaired` in order is a false alarm. A repair of mirrored normals counts where it names
    just the views that were mirrored. Beside them stands what the thresholds in question are compared with.
    """
    camera = scene.train[0].camera
    about = {"seed": seed, "width": camera.width, "height": camera.height, "views": len(scene.train)}
    rows = []
    for spoiled, severity in (("", 0), *SPOILED):
        changed = PERTURBATIONS[spoiled].applied(scene, severity, spoiled, seed) if spoiled else scene
        diagnosis = Diagnosis(changed, device)
        right = {outcome.kind for outcome in repaired(diagnosis, list(REPAIRS))[1] if outcome.kept}
        turned = {a.name for a, b in zip(scene.train, changed.train, strict=True) if a is not b}
        if spoiled == "normals_mirrored" and set(diagnosis.mirrored.views) != turned:
            right.discard("normals")
        warned = (warning.kind for warning in scene_warnings(diagnosis, PLENTY))
        measured = {name: round(MEASURED[name](diagnosis), DIGITS) for name in COMPARED[spoiled]}
        said = {"warned": " ".join(sorted(warned)), "repaired": " ".join(sorted(right))}
        rows.append({**about, "spoiled": spoiled, "severity": severity, **said, **measured})
    return rows
