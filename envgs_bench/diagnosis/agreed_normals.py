"""What the harness hands to methods that learn from normals in agreement: the scene's NormalPrior."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from torch import Tensor

from envgs_bench.core import Scene, View
from envgs_bench.core.normal_prior import NormalPrior, share_of

from .diagnosis import Diagnosis
from .normal_agreement import corrected
from .plane_sweep import depth_range
from .seen_through import seen_through
from .thresholds import AGREEING, MAYBE_SEEN_THROUGH, SEEN_THROUGH

CORRECTED = 1.4  # × what two corrected normals differ by at a point: mirrors, which have none, are corrected less


@dataclass(frozen=True)
class _Agreed:
    """A view with its normals turned by its corrections, [R + 1, C + 1, 3] by views' names."""

    corrections: Mapping[str, Tensor]

    def __call__(self, view: View) -> View:
        if view.normal is None or view.name not in self.corrections:
            return view
        return replace(view, normal=corrected(view.normal, self.corrections[view.name]))


def with_agreed_normals(diagnosis: Diagnosis) -> Scene:
    """The scene with what its views' normals are worth; as it is where no training view has any."""
    scene, observations = diagnosis.scene, diagnosis.observations
    count = len(scene.train)
    if all(view.normal is None for view in scene.train):
        return scene
    found, notes = diagnosis.agreement, []
    agreed = _Agreed(found.corrections)
    disagreement = observations.normal_disagreement(found.normals)
    if found.corrections:
        given = observations.normal_disagreement(observations.seen_normals)
        notes.append(
            f"turns the normals of {len(found.corrections)} of {count} training views, smoothly over each picture, to "
            f"agree: two views' differ by {disagreement:.1f}° at the same point, as given by {given:.1f}°"
        )
    remaining = disagreement * (CORRECTED if found.corrections else 1)
    weight = (AGREEING / max(remaining, AGREEING)) ** 2  # as the inverse of their variance
    if weight < 1:
        notes.append(f"counts the training views' normals {weight:.2f} × as much, since these still differ so much")
    views = (agreed(view.pixels_on(diagnosis.device)) for view in scene.train)
    seen = seen_through(views, *depth_range(scene, diagnosis.near), diagnosis.device)
    least = ((seen.sure, SEEN_THROUGH), (seen.likely, MAYBE_SEEN_THROUGH))
    sure, likely = (cells if share_of(cells, count) >= share else {} for cells, share in least)
    return replace(scene, normals=NormalPrior(agreed, weight, sure, likely, notes))
