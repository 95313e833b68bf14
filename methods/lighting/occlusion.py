"""Occluders: surfels of the base set that hide a map of the surroundings from rays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from envgs_bench.core import Bvh, GaussianSet, Scene, build_bvh, trace_color
from envgs_bench.parts import BASE

from ..gaussians.model import GaussianModel
from ..gaussians.regions import Ball, foreground_ball
from ..training.schedule import Part

OWN_SURFACE = 0.01  # hits of a mirrored ray nearer than this are of the surface that it leaves, × scene radius
HIDES_WITHIN = 2.0  # what hides the map, around what the cameras look at, × their mean distance from it


class Occluders(Part):
    """Attributes:
    traced: whether they are, as of the last step.
    """

    def __init__(self, model: GaussianModel) -> None:
        self.traced = False
        self._model = model
        self._near = Ball(torch.zeros(3), math.inf)
        self._of_images: tuple[GaussianSet, Bvh] | None = None

    def start(self, scene: Scene) -> None:
        self.traced = False
        around = foreground_ball([view.camera for view in scene.train])
        self._near = Ball(around.center.to(self._model.device), HIDES_WITHIN * around.radius)

    def prepare(self) -> None:
        self._of_images = None
        if self.traced:
            near = self._near_set(None)
            self._of_images = near, build_bvh(near, backend=self._model.settings.backend)

    @torch.no_grad()
    def hidden(self, origins: Tensor, directions: Tensor, step: int | None) -> Tensor:
        """How much of the map is hidden from each ray, [H, W] from 0 to 1."""
        hides = self._of_images if step is None else (self._near_set(step), None)
        assert hides is not None
        near, bvh = hides
        return trace_color(
            near,
            origins.detach(),
            directions.detach(),
            t_min=OWN_SURFACE * self._model.radius,
            bvh=bvh,
            backend=self._model.settings.backend,
        )[1]

    def training_state(self) -> dict[str, Any]:
        return {"traced": self.traced}

    def restore_training(self, state: Mapping[str, Any]) -> None:
        self.traced = state["traced"]

    def state(self) -> dict[str, Any]:
        return {"indirect": self.traced, "near_ball": {"center": self._near.center, "radius": self._near.radius}}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.traced, self._near = state["indirect"], Ball(**state["near_ball"])

    def _near_set(self, step: int | None) -> GaussianSet:
        """The surfels that may hide the map, which is what lies beyond them: a far sky among them would hide it all."""
        base = self._model.gaussians(BASE, step)
        near = (base.means.detach() - self._near.center).norm(dim=1) <= self._near.radius
        opacities = torch.where(near, base.opacities, 0.0)  # not rows of them, for whose number the host would wait
        return replace(base, opacities=opacities, sh=base.sh[:, :1], extras=None).map(Tensor.detach)
