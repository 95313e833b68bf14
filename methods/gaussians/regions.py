"""Regions found in a trained model: where a view shows reflecting things, and where these reflect what is near.

`reflective` is made as the EnvGS paper makes it (App. A.1): of the trained base set, only the primitives of the
reflecting foreground are kept and drawn, and their alpha is cut in two. The paper picks them by hand, here they are
those with a high β near the middle of the scene. `near_field` is ours; the paper annotates it by hand: the reflective
pixels whose reflected ray hits the base set.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from envgs_bench.core import Bvh, Camera, GaussianSet, Rendering, Scene, rasterize, reflect, trace_color

MIN_ALPHA = 0.5  # alpha above which a pixel or a ray counts as a hit
OWN_SURFACE = 0.01  # hits nearer than this are of the reflecting surface itself, × scene radius


@dataclass(frozen=True)
class Ball:
    center: Tensor  # [3], world frame
    radius: float  # world units


def foreground_ball(cameras: Sequence[Camera]) -> Ball:
    """What the cameras stand around: the point nearest to all their axes, and their mean distance from it.

    The point minimizes Σ ‖(I − zzᵀ)(p − c)‖² over the cameras' centers c and viewing directions z. Means little where
    cameras look outward or all the same way.
    """
    centers = torch.stack([camera.center for camera in cameras]).double()
    axes = torch.stack([camera.world_to_camera[2, :3] for camera in cameras]).double()
    across = torch.eye(3, dtype=torch.float64) - axes[:, :, None] * axes[:, None, :]
    center = torch.linalg.lstsq(across.sum(0), (across @ centers[:, :, None]).sum(0)).solution[:, 0]
    return Ball(center.float(), float((centers - center).norm(dim=1).mean()))


class Scope:
    """The ball that may mirror, around what the cameras look at; everything, where its size is 0.

    Args:
        size: its radius, × the cameras' mean distance from its middle.
    """

    def __init__(self, size: float, device: torch.device) -> None:
        self._size, self._ball = size, Ball(torch.zeros(3, device=device), math.inf)

    def start(self, scene: Scene) -> None:
        if self._size:
            around = foreground_ball([view.camera for view in scene.train])
            self._ball = Ball(around.center.to(self._ball.center), self._size * around.radius)

    def inside(self, base: Rendering, camera: Camera) -> Tensor:
        """Whether a pixel's surface lies in it, [H, W, 1]."""
        origins, directions = camera.rays()
        points = origins + base.depth.detach()[..., None] * directions
        return (points - self._ball.center).norm(dim=-1, keepdim=True) <= self._ball.radius

    def state(self) -> dict[str, Any]:
        return {"scope": {"center": self._ball.center, "radius": self._ball.radius}}

    def restore(self, state: Mapping[str, Any]) -> None:
        self._ball = Ball(state["scope"]["center"], state["scope"]["radius"])


def reflecting(base: GaussianSet, ball: Ball, beta_min: float) -> Tensor:
    """Which primitives [N] of a base set lie in the ball and have a β above `beta_min`.

    Raises:
        ValueError: the set has no β.
    """
    if base.extras is None or base.extras.shape[1] != 1:
        raise ValueError("the base set has no β: reflecting things are found with a trained EnvGS")
    near = (base.means - ball.center.to(base.means)).norm(dim=1) <= ball.radius
    return near & (base.extras[:, 0] > beta_min)


def in_box(base: GaussianSet, low: Tensor, high: Tensor) -> Tensor:
    """Which primitives' centers [N] lie in the axis-aligned box with these corners [3]."""
    return ((base.means >= low.to(base.means)) & (base.means <= high.to(base.means))).all(dim=1)


@torch.no_grad()
def reflective_mask(foreground: GaussianSet, camera: Camera, near: float = 0.2) -> Tensor:
    """Where the kept primitives alone, without whatever stands before them, are more opaque than not: [H, W] bool.

    `near` is that of `rasterize`, world units.
    """
    return rasterize(foreground, camera, near=near).alpha > MIN_ALPHA


@torch.no_grad()
def near_field_mask(
    base: GaussianSet,
    surroundings: GaussianSet,
    camera: Camera,
    radius: float,
    near: float = 0.2,
    bvh: Bvh | None = None,
) -> Tensor:
    """Where the view's reflected rays hit the surroundings: [H, W] bool. To be intersected with `reflective_mask`.

    Args:
        base: the whole base set, whose normals reflect.
        surroundings: what rays may hit: the base set's part within the scene's box.
        radius: the scene's, world units.
        near: as for `rasterize`, world units.
        bvh: that of the surroundings; built here where None.
    """
    shown = rasterize(base, camera, near=near)
    offset = OWN_SURFACE * radius
    origins, directions, _ = reflect(shown, camera)
    alpha = trace_color(surroundings, origins, directions, t_min=offset, bvh=bvh)[1]
    return alpha > MIN_ALPHA
