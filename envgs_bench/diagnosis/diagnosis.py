"""Diagnosis: all that a scene's photographs say of its points, poses, exposures and normals, each found once."""

from __future__ import annotations

from functools import cached_property

import torch
from torch import Tensor

from envgs_bench.core import Scene

from .coverage import coverage
from .exposures import Exposures, exposures
from .mirrored_normals import Mirrored, mirrored_views, normals_unmirrored
from .normal_agreement import NormalAgreement, normal_agreement
from .observations import Observations
from .photographs import Photographs
from .poses import Alignment, alignment
from .thresholds import MISSING, TELLING, UNSUPPORTED

NEAR = 0.05  # × the scene radius: a point nearer to a camera is not where it should be


class Diagnosis:
    """What is known of a scene with points, found when it is first asked for.

    Args:
        scene: looked at as it is.
        device: where all pixels and points are looked at, much sooner on a GPU.
    """

    def __init__(self, scene: Scene, device: torch.device | str = "cpu") -> None:
        self.scene, self.device = scene, torch.device(device)
        self.near = max(scene.free_space, NEAR * scene.radius)

    @cached_property
    def observations(self) -> Observations:
        return Observations.of(self.scene, self.near)

    @cached_property
    def photo_consistency(self) -> float:
        """See `Observations.photo_consistency`."""
        return self.observations.photo_consistency()

    @cached_property
    def parallax(self) -> float:
        """Degrees; see `Observations.parallax`."""
        return self.observations.parallax()

    @cached_property
    def coverage(self) -> float:
        """Share of what the median view shows that has a point."""
        return coverage(self.scene, self.near, self.device)

    @property
    def points_in_order(self) -> bool:
        """Whether the points are enough, and where pictures show them: others say nothing of poses and exposures."""
        return self.photo_consistency >= UNSUPPORTED and self.coverage >= TELLING

    @cached_property
    def alignment(self) -> Alignment:
        return alignment(self.observations, self.device)

    @property
    def poses_told(self) -> bool:
        """Whether points say anything of poses."""
        return self.points_in_order and not self.observations.colorless

    @cached_property
    def exposures(self) -> Exposures:
        return exposures(self.observations, self.device)

    @cached_property
    def mirrored(self) -> Mirrored:
        """The views whose normals are mirrored; none where points are wrong, and normals at them agree by chance."""
        if self.photo_consistency < UNSUPPORTED or self.coverage < MISSING:
            return Mirrored([], 0.0)
        return mirrored_views(self.observations)

    @cached_property
    def normals(self) -> Tensor:
        """The views' normals at the points [V, P, 3], those of mirrored views mirrored back."""
        return normals_unmirrored(self.observations, self.mirrored.views)

    @cached_property
    def disagreement(self) -> float:
        """Degrees by which two views' normals of a point usually differ."""
        return self.observations.normal_disagreement(self.normals)

    @cached_property
    def agreement(self) -> NormalAgreement:
        """That of the normals as given: mirrored views are the run's to repair."""
        return normal_agreement(self.observations, self.observations.seen_normals)

    @cached_property
    def photographs(self) -> Photographs:
        return Photographs.of(self.scene.train, self.device)
