"""Depths of single pixels from photographs alone: a sparse plane sweep (Collins, CVPR 1996).

A pixel's depth is that at which the patch around it looks alike in the nearest other views. It is taken for known
only where all other depths look clearly worse: neither walls without texture nor curved mirrors have such depths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, Scene, View

WIDTH = 160  # pixels: pictures at least twice as wide are reduced, by a whole factor, to less than twice this
NEIGHBORS = 4  # other views that a patch is looked for in
AGREEING = 2  # of them that must show it: others may see something in front
PATCH = 2  # pixels of the reduced picture between a patch's 3 × 3 samples
DEPTHS = 64  # in geometric progression, of a first sweep over all depths
FINER = 9  # of a second one around the best of them
CLEARLY = 0.6  # × the least difference at any other depth is the most that a match may have
LEAST_CONTRAST = 0.01  # by how much other depths must look worse, of the range of sRGB
OTHERWISE = 2  # depths beside the best that are no others
NEAREST, FARTHEST = 0.1, 20.0  # depths that are swept, × the scene radius


def depth_range(scene: Scene, near: float) -> tuple[float, float]:
    """Between which depths a sweep looks, world units; `near` is the nearest that anything may have."""
    scale = scene.radius or 1.0
    return max(near, NEAREST * scale), FARTHEST * scale


@dataclass(frozen=True)
class SweptView:
    """A view as it is swept: its picture [1, 3, h, w], narrower than 2·WIDTH."""

    camera: Camera
    picture: Tensor

    @classmethod
    def of(cls, view: View, device: torch.device) -> SweptView:
        picture = view.rgb(device).permute(2, 0, 1)[None]
        factor = view.camera.width // WIDTH
        if factor > 1:
            size = (max(1, round(view.camera.height / factor)), round(view.camera.width / factor))
            picture = functional.interpolate(picture, size, mode="area")
        return cls(view.camera.to(device), picture)

    def colors(self, points: Tensor) -> Tensor:
        """The picture's colors at the points [..., 3], NaN where it does not show them; [..., 3]."""
        to_picture = self._to_picture
        colors, inside = self._at((points @ to_picture[:, :3].T + to_picture[:, 3]).movedim(-1, 0))
        return torch.where(inside > 0, colors, torch.nan).movedim(0, -1)

    def colors_along(self, center: Tensor, directions: Tensor, depths: Tensor) -> tuple[Tensor, Tensor]:
        """What the picture shows at depths along rays.

        A homogeneous position is linear in the depth, so that no point in the world is made: half the work. Depths are
        the last dimension, where work on neighboring values is quickest.

        Args:
            center: [3] where the rays begin, world frame.
            directions: [P, K, 3] of the rays, world frame.
            depths: [K, D] along each of the P × K rays.

        Returns:
            Colors [3, P, K, D], and [P, K, D] more than 0 where the picture shows the point.
        """
        to_picture = self._to_picture
        along = (directions @ to_picture[:, :3].T).movedim(-1, 0)[..., None]
        begin = to_picture[:, :3] @ center + to_picture[:, 3]
        return self._at((along * depths).add_(begin.view(3, 1, 1, 1)))

    @property
    def _to_picture(self) -> Tensor:
        """[3, 4] from world points to homogeneous positions, −1 to 1 along both sides of the picture."""
        x, y, depth = self.camera.intrinsics @ self.camera.world_to_camera[:3]
        return torch.stack([x * (2 / self.camera.width) - depth, y * (2 / self.camera.height) - depth, depth])

    def _at(self, positions: Tensor) -> tuple[Tensor, Tensor]:
        """Colors [3, ...] at homogeneous positions [3, ...], and what is more than 0 of points in the picture [...]."""
        at = positions[:2] / positions[2]
        sampled = functional.grid_sample(
            self.picture, at.flatten(1).T[None, None], padding_mode="border", align_corners=False
        )
        return sampled.reshape(3, *at.shape[1:]), torch.minimum(1 - at.abs().amax(dim=0), positions[2])


@dataclass(frozen=True)
class Matches:
    """How the nearest other views show K pixels of a view at each of the depths that are looked at.

    Attributes:
        best: [K] index of the depth at which they show them least differently.
        clear: [K] whether something lies at that depth: at all others it looks clearly worse.
    """

    best: Tensor
    clear: Tensor

    @classmethod
    def of(cls, differences: Tensor) -> Matches:
        """Of differences [K, DEPTHS]."""
        least, best = differences.min(dim=1)
        elsewhere = (torch.arange(DEPTHS, device=best.device) - best[:, None]).abs() > OTHERWISE
        other = torch.where(elsewhere, differences, torch.inf).amin(dim=1)
        return cls(best, (best > 0) & (best < DEPTHS - 1) & _clearly(least, other))


class PlaneSweep:
    """Views, all on one device, that are swept for the depths of each other's pixels.

    Args:
        near, far: depths between which something is looked for, world units, 0 < near < far.

    Attributes:
        neighbors: of each view the nearest ones that look in about the same direction; none if too few do.
    """

    def __init__(self, views: Sequence[SweptView], near: float, far: float) -> None:
        self.views = views
        self._step = (far / near) ** (1 / (DEPTHS - 1))
        centers = torch.stack([each.camera.center for each in views])
        axes = torch.stack([each.camera.world_to_camera[2, :3] for each in views])
        self.depths = near * self._step ** torch.arange(DEPTHS, device=centers.device)
        self.neighbors = [[views[row] for row in _nearest(centers, axes, index)] for index in range(len(views))]

    def matches(self, index: int, pixels: Tensor) -> Matches:
        """Those of pixel positions (x, y) [K, 2] of a view that has neighbors."""
        depths = self.depths.expand(len(pixels), -1)
        return Matches.of(_differences(self.views[index], self.neighbors[index], pixels, depths))

    def finer(self, index: int, pixels: Tensor, best: Tensor) -> Tensor:
        """Depths [K] of the pixels [K, 2], from a second sweep around the best [K] of the first."""
        around = self._step ** torch.linspace(-1, 1, FINER, device=pixels.device)
        depths = self.depths[best][:, None] * around
        differences = _differences(self.views[index], self.neighbors[index], pixels, depths)
        return depths.gather(1, differences.argmin(dim=1)[:, None])[:, 0]

    def points(self, index: int, pixels: Tensor, depths: Tensor) -> Tensor:
        """Points [K, 3], world frame, at the depths [K] of the view's pixels [K, 2]."""
        camera = self.views[index].camera
        return camera.center + depths[:, None] * _directions(camera, pixels)


def _nearest(centers: Tensor, axes: Tensor, index: int) -> list[int]:
    distance = (centers - centers[index]).norm(dim=1)
    usable = (axes @ axes[index] > 0.5) & (distance > 1e-6)
    count = min(NEIGHBORS, int(usable.sum()))
    return torch.where(usable, distance, torch.inf).argsort()[:count].tolist() if count >= AGREEING else []


def _clearly(least: Tensor, other: Tensor) -> Tensor:
    return other.isfinite() & (least < CLEARLY * other) & (other - least > LEAST_CONTRAST)


def _differences(view: SweptView, others: list[SweptView], pixels: Tensor, depths: Tensor) -> Tensor:
    """How differently the patches around the pixels [K, 2] look in other views at the depths [K, D], [K, D].

    The mean absolute difference over the patch in the views that agree best, infinite where too few show all of it.
    """
    scale = view.camera.width / view.picture.shape[3]
    around = torch.cartesian_prod(*2 * [torch.arange(-1, 2, device=pixels.device)]) * PATCH * scale
    patch = pixels + around[:, None]  # [9, K, 2]
    directions = _directions(view.camera, patch.reshape(-1, 2)).reshape(len(around), len(pixels), 3)
    own = view.colors(view.camera.center + depths[:, :1] * directions).movedim(-1, 0)[..., None]
    each = torch.stack([_beside(own, *other.colors_along(view.camera.center, directions, depths)) for other in others])
    return each.nan_to_num(torch.inf).sort(dim=0).values[:AGREEING].mean(dim=0)


def _beside(own: Tensor, colors: Tensor, inside: Tensor) -> Tensor:
    """The mean difference [K, D] of patches [3, P, K, D] from [3, P, K, 1], NaN where not all of it is `inside`."""
    return torch.where(inside.amin(dim=0) > 0, (colors - own).abs_().mean(dim=(0, 1)), torch.nan)


def _directions(camera: Camera, pixels: Tensor) -> Tensor:
    """World-frame directions [K, 3] through the pixel positions [K, 2], camera z = 1."""
    return functional.pad(pixels, (0, 1), value=1.0) @ camera.pixel_to_direction().T
