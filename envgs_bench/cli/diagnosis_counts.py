"""What diagnosis says of a scene in order, and of the same spoiled on purpose."""

from __future__ import annotations

from typing import Any

import torch

from envgs_bench.core import Scene
from envgs_bench.datasets.perturbations.registry import PERTURBATIONS
from envgs_bench.diagnosis.diagnosis import Diagnosis
from envgs_bench.diagnosis.repair import REPAIRS, repaired
from envgs_bench.diagnosis.scene_warnings import scene_warnings

PLENTY = 10**6  # steps, so that no scene's training is too short
SPOILED = (  # what, and how severely
    *(("exposure", severity) for severity in (2, 3)),
    ("pose_rotation", 3),
    *(("normals_mirrored", severity) for severity in (1, 2, 3)),
)


def counted(scene: Scene, seed: int, device: torch.device | str = "cpu") -> list[dict[str, Any]]:
    """A row for the scene in order, of `spoiled` "", and one for each way in which it is spoiled.

    What is `warned` of and `repaired` in order is a false alarm. A repair of mirrored normals counts where it names
    just the views that were mirrored. Beside them stands what the thresholds are compared with.
    """
    camera = scene.train[0].camera
    about = {"seed": seed, "width": camera.width, "height": camera.height, "views": len(scene.train)}
    rows = []
    for spoiled, severity in (("", 0), *SPOILED):
        changed = PERTURBATIONS[spoiled].applied(scene, severity, spoiled, seed) if spoiled else scene
        diagnosis = Diagnosis(changed, device)
        right = {outcome.kind for outcome in repaired(diagnosis, list(REPAIRS))[1] if outcome.kept}
        turned = {a.name for a, b in zip(scene.train, changed.train, strict=True) if a is not b}
        if spoiled == "normals_mirrored" and set(diagnosis.mirrored) != turned:
            right.discard("normals")
        warned = (warning.kind for warning in scene_warnings(diagnosis, PLENTY))
        said = {"warned": " ".join(sorted(warned)), "repaired": " ".join(sorted(right))}
        rows.append({**about, "spoiled": spoiled, "severity": severity, **said, **_measured(diagnosis)})
    return rows


def _measured(diagnosis: Diagnosis) -> dict[str, float]:
    """What the thresholds are compared with."""
    return {
        "stops": round(diagnosis.exposures.stops, 3),
        "pose_gain": round(diagnosis.alignment.gain, 3),
        "photo_consistency": round(diagnosis.photo_consistency, 3),
        "coverage": round(diagnosis.coverage, 3),
        "normal_disagreement": round(diagnosis.disagreement, 1),
        "noise": round(diagnosis.photographs.noise, 4),
        "detail": round(diagnosis.photographs.detail, 4),
        "blockiness": round(diagnosis.photographs.blockiness, 3),
    }
