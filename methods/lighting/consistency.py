"""Consistency: what one view says of a surface holds in a neighboring one (after MaterialRefGS, and PGSR for planes).

A pixel's surface point, drawn by one view, is looked up in a neighbor's depth and projected back: φ pixels beside where
it came from. Where φ is small both see the same surface. Then a patch of the photograph, moved along the surface's
plane, shows what the neighbor's photograph does; and base color and β are the same, as they are the surface's own.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, Rendering, Scene, View
from envgs_bench.core.vectors import unit
from envgs_bench.parts import BASE

from ..gaussians.model import GaussianModel
from ..training.schedule import Part

SURFACES_FROM, MATERIALS_FROM = 7_000, 10_000  # steps of a run of 30,000 after which they count
NEIGHBORS, TURN, APART = 8, 30.0, 0.01  # of a view, at most; degrees they look apart, at most; × scene radius, at least
SAME = 1.0  # φ, pixels, below which both views see one surface
DEPTHS, PATCHES, COLORS, STRENGTHS = 0.03, 0.15, 0.225, 0.05  # weights of φ, of patches, of base colors, of β
PATCH, MOST = 3, 102_400  # pixels from a patch's middle to its edges; patches, at most
MATTE = 0.4  # sum of both views' β below which patches are compared
ALIKE = 0.9  # 1 − correlation of patches, below which they may show the same
FAINT = 1e-8  # variance² of gray below which a patch shows nothing
GRAY = (0.299, 0.587, 0.114)  # ITU-R BT.601


@dataclass(frozen=True)
class Seen:
    """What a view shows of surfaces: camera-frame z, world-frame normals, base color, β, and its photograph in gray."""

    camera: Camera
    depth: Tensor  # [H, W], 0 where nothing is
    normal: Tensor  # [H, W, 3]
    color: Tensor  # [H, W, 3]
    beta: Tensor  # [H, W, 1]
    gray: Tensor  # [H, W, 1]

    @classmethod
    def of(cls, drawn: Rendering, view: View) -> Seen:
        color = drawn.layers.get(BASE, drawn.color)
        gray = view.rgb(color.device) @ color.new_tensor(GRAY)
        return cls(view.camera, drawn.depth, drawn.normal, color, drawn.extras[..., :1], gray[..., None])


class Consistency(Part):
    """A loss between a training view and one of its neighbors, another at each step.

    Args:
        weight: × all of its terms; 1 is the published one.
        on_device: a training view -> the same on the model's device.
    """

    def __init__(self, model: GaussianModel, weight: float, on_device: Callable[[View], View]) -> None:
        self._model, self._weight, self._on_device = model, weight, on_device
        self._neighbors: dict[str, list[View]] = {}

    def start(self, scene: Scene) -> None:
        found = neighbors([view.camera for view in scene.train], APART * self._model.radius)
        near = [[scene.train[row] for row in rows] for rows in found]
        self._neighbors = {view.name: own for view, own in zip(scene.train, near, strict=True)}

    def phase(self, step: int) -> Hashable:
        at = self._model.schedule.at
        return step > at(SURFACES_FROM), step > at(MATERIALS_FROM)

    def losses(self, rendering: Rendering, view: View, step: int) -> dict[str, Tensor]:
        """The weighted loss by name, a scalar; none before it counts, nor of a view without neighbors.

        Args:
            rendering: of the view, with β as its first extra channel.
        """
        surfaces, materials = (
            step > self._model.schedule.at(SURFACES_FROM),
            step > self._model.schedule.at(MATERIALS_FROM),
        )
        known = self._neighbors[view.name]
        if not surfaces or not known:
            return {}
        other = self._on_device(known[step % len(known)])
        drawn = self._model.rasterize(other.camera, step)
        loss = disagreement(Seen.of(rendering, view), Seen.of(drawn, other), step, materials)
        return {"consistency": self._weight * loss}


def disagreement(one: Seen, other: Seen, step: int, materials: bool) -> Tensor:
    """The loss between two views, a scalar; of base colors and β too where `materials`.

    Args:
        step: by which other pixels' patches are compared, where pictures are large.
    """
    at, noise = returned(one.depth, other.depth, one.camera, other.camera)
    same = noise < SAME
    trust = torch.where(same, (-noise.detach()).exp(), 0.0)
    beta = sampled(other.beta, at.detach())
    matte = trust * ((one.beta + beta)[..., 0] < MATTE)
    loss = DEPTHS * mean_over(same, trust * noise) + PATCHES * patch_error(one, other, matte, step)
    if not materials:
        return loss
    colors = (one.color - sampled(other.color, at.detach())).abs().sum(-1)
    most = torch.maximum(one.beta, beta).detach()
    apart = (most * ((most - one.beta).abs() + (most - beta).abs()))[..., 0]  # the larger learns nothing
    return loss + COLORS * mean_over(same, trust * colors) + STRENGTHS * mean_over(same, trust * apart)


def patch_error(one: Seen, other: Seen, trust: Tensor, step: int) -> Tensor:
    """The mean of 1 − correlation between patches and what they show in another view, over trusted pixels [H, W]."""
    height, width = trust.shape
    apart = 1
    while -(-height // apart) * -(-width // apart) > MOST:
        apart += 1
    rows = slice(step % apart, None, apart), slice(step // apart % apart, None, apart)
    own, there = warped(one.depth, one.normal, one.camera, other.camera, rows)
    error = 1 - correlation(sampled(one.gray, own)[..., 0], sampled(other.gray, there)[..., 0])
    return mean_over((trust[rows] > 0) & (error.detach() < ALIKE), trust[rows] * error)


def mean_over(where: Tensor, values: Tensor) -> Tensor:
    """The mean of values [...] where a mask [...] is true; 0 where it is true nowhere."""
    return torch.where(where, values, 0.0).sum() / where.sum().clamp_min(1)


def neighbors(cameras: Sequence[Camera], apart: float) -> list[list[int]]:
    """The cameras nearest to each, nearest first, that look about its way and stand `apart` from it, world units."""
    centers = torch.stack([camera.center for camera in cameras]).double()
    ahead = torch.stack([camera.world_to_camera[2, :3] for camera in cameras]).double()
    distances = torch.cdist(centers, centers)
    turned = torch.rad2deg((ahead @ ahead.T).clamp(-1, 1).arccos())
    found = []
    for own, turn in zip(distances, turned, strict=True):
        order = own.argsort(stable=True)
        kept = order[((own > apart) & (turn <= TURN))[order]]
        found.append(kept[:NEIGHBORS].tolist())
    return found


def returned(depth: Tensor, others: Tensor, camera: Camera, other: Camera) -> tuple[Tensor, Tensor]:
    """Where each pixel's point lies in another view [H, W, 2], pixels; and φ [H, W], infinite where it is not seen.

    φ is how far from the pixel's center that view's own point there is projected back to. Differentiable in the depths.

    Args:
        depth: [H, W] camera-frame z of the one view, 0 where there is none.
        others: [h, w] the other's.
    """
    origins, directions = camera.rays()
    at, z = other.project(origins + depth[..., None] * directions)
    found = sampled(others[..., None], at)
    ways = torch.cat([at, torch.ones_like(found)], dim=-1) @ other.pixel_to_direction().T
    back, behind = camera.project(other.center + found * ways)
    start, _ = camera.project(origins + directions)
    size = at.new_tensor([other.width, other.height])
    seen = (depth > 0) & (z > 0) & (found[..., 0] > 0) & (behind > 0) & ((at > 0) & (at < size)).all(-1)
    start = torch.where(seen[..., None], start, 0.0)
    back = torch.where(seen[..., None], back, 0.0)
    noise = (back - start).square().sum(-1).clamp_min(1e-12).sqrt()
    return at, torch.where(seen, noise, torch.inf)


def warped(
    depth: Tensor, normal: Tensor, camera: Camera, other: Camera, rows: tuple[slice, slice]
) -> tuple[Tensor, Tensor]:
    """Pixel positions [h, w, P, 2] of a patch around each pixel, and where its plane shows them in another view.

    The plane goes through the pixel's point, with its normal: what a ray of the patch meets there is projected.

    Args:
        depth, normal: [H, W] camera-frame z, and [H, W, 3] world frame.
        rows: which pixels' patches, [h, w] of them.
    """
    origins, directions = (rays[rows] for rays in camera.rays())
    reach = torch.arange(-PATCH, PATCH + 1, dtype=depth.dtype, device=depth.device)
    offsets = torch.cartesian_prod(reach, reach).flip(-1)
    middle, _ = camera.project(origins + directions)
    own = middle[..., None, :] + offsets
    ways = torch.cat([own, torch.ones_like(own[..., :1])], dim=-1) @ camera.pixel_to_direction().T
    facing = unit(normal[rows])
    height = depth[rows] * (facing * directions).sum(-1)
    steep = (ways * facing[..., None, :]).sum(-1)
    far = height[..., None] / torch.where(steep.abs() < 1e-6, -1e-6, steep)
    there, _ = other.project(origins[..., None, :] + far[..., None] * ways)
    return own, there


def sampled(values: Tensor, at: Tensor) -> Tensor:
    """Values [H, W, C] interpolated at pixel positions [..., 2], [..., C]; those of the border beyond it."""
    height, width, channels = values.shape
    where = (2 * at / at.new_tensor([width, height]) - 1).nan_to_num().reshape(1, -1, 1, 2)
    found = functional.grid_sample(
        values.movedim(-1, 0)[None], where, mode="bilinear", padding_mode="border", align_corners=False
    )
    return found[0, :, :, 0].T.reshape(*at.shape[:-1], channels)


def correlation(one: Tensor, other: Tensor) -> Tensor:
    """Pearson's of each pair of patches [..., P], [...]; 0 where a patch shows nothing."""
    one, other = (each - each.mean(-1, keepdim=True) for each in (one, other))
    both = (one * other).mean(-1)
    return both * (one.square().mean(-1) * other.square().mean(-1) + FAINT).rsqrt()
