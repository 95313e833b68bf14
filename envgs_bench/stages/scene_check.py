"""What is wrong with a scene before anything is trained on it, and would not show in a training that fits what it sees.

A run with too few views, or with points or normals that contradict the pictures, learns the training views and fails
on all others. Its losses know nothing of that; the scene does (`envgs_bench.methods.start.evidence`).
"""

from __future__ import annotations

import torch

from envgs_bench.core import Scene
from envgs_bench.methods.start.evidence import Evidence, empty_cells
from envgs_bench.methods.start.mending import MISSING, UNSUPPORTED
from envgs_bench.records import TrainingWarning, WarningKind

SPARSE = 12.0  # degrees between the two nearest views of a point from which views are too few to agree on its depth


def scene_warnings(scene: Scene, device: torch.device | str = "cpu") -> list[TrainingWarning]:
    """What training views, points and normals warn of; each of step 0. All pixels are looked at on `device`."""
    if not len(scene.points):
        return []  # the method refuses them
    evidence = Evidence.of(scene, scene.free_space)
    covered = empty_cells(scene, scene.free_space, device)[1]
    support, parallax = evidence.support(), evidence.parallax()
    mirrored, views = len(evidence.mirrored_views()), len(scene.train)
    found: list[tuple[WarningKind, bool, str]] = [
        (
            "views_sparse",
            parallax > SPARSE and support >= UNSUPPORTED,  # else points say nothing of views
            f"a point is usually seen from {parallax:.0f}° beside in the nearest other of {views} training views: "
            "what is not seen from there may be wrong in test views",
        ),
        (
            "points_missing",
            covered < MISSING,
            f"points lie in only {covered:.0%} of the parts of a training view that show something",
        ),
        (
            "points_unsupported",
            support < UNSUPPORTED,
            f"the points' colors are only {support:.0%} nearer to what the views show there than other points' are: "
            "the points, or the poses, are not those of the pictures",
        ),
        (
            "normals_mirrored",
            mirrored > 0,
            f"the normals of {mirrored} of {views} training views agree with the others' only when they are mirrored "
            "from left to right: their axes may follow another convention",
        ),
    ]
    return [TrainingWarning(kind=kind, step=0, part="", message=text) for kind, wrong, text in found if wrong]
