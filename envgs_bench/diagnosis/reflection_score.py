"""Where photographs reflect: how differently other views show what a surface shows (after MaterialRefGS).

A diffuse surface has one color from everywhere. What a mirror shows moves over it, so that other views see another
color at the same point. The surface itself has to be known: where depths are those of what is mirrored, as behind a
flat mirror, nothing looks different.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, View
from envgs_bench.core.vectors import unit

WIDTH = 96  # pixels: pictures at least twice as wide are reduced, by a whole factor, to less than twice this
PATCH, AROUND = 5, 9  # pixels across WIDTH of them: of a patch whose color is compared; that share a score
NEIGHBORS = 20  # other views, the nearest, that a surface is looked at from
ANGLES = (5.0, 90.0)  # degrees between two of their lines of sight
SAME = 0.02  # × the depth: what lies nearer or farther than that hides the surface
LEAST_VIEWS = 3  # that must show it
LEAST_SHARE = 0.3  # of a patch
REFLECTS = 0.045  # mean difference of colors, of the range of sRGB, above which a surface reflects


@dataclass(frozen=True)
class Surface:
    """A reduced view: its camera, its picture [3, h, w], and depths [h, w] of `Camera.rays`, 0 where nothing is."""

    camera: Camera
    picture: Tensor
    depth: Tensor

    @classmethod
    def size(cls, camera: Camera) -> tuple[int, int]:
        """Height and width of the reduced view."""
        factor = max(1, camera.width // WIDTH)
        return max(1, round(camera.height / factor)), round(camera.width / factor)

    @classmethod
    def of(cls, view: View, depth: Tensor) -> Surface:
        """Of a view and its depths, of its reduced size and on the device of all that follows."""
        picture = view.rgb(depth.device).permute(2, 0, 1)[None]
        reduced = functional.interpolate(picture, depth.shape, mode="area")[0]
        camera = view.camera.resized(depth.shape[1], depth.shape[0]).to(depth.device)
        return cls(camera, reduced, depth)

    def points(self) -> Tensor:
        origins, rays = self.camera.rays()
        return origins + self.depth[..., None] * rays


@torch.no_grad()
def reflection_score(own: Surface, others: Sequence[Surface]) -> Tensor:
    """The mean difference of color [h, w] between a view and the nearest others, NaN where too few show the surface.

    Colors are means over patches, in [0, 1]: texture finer than a patch, which is sampled anew in each view, cancels.
    """
    centers = torch.stack([each.camera.center for each in others])
    nearest = (centers - own.camera.center).norm(dim=1).argsort()[:NEIGHBORS].tolist()
    points = own.points()
    toward = unit(own.camera.center - points)
    patch, around = (_odd(size * own.depth.shape[1] / WIDTH) for size in (PATCH, AROUND))
    total, count = torch.zeros_like(own.depth), torch.zeros_like(own.depth)
    for each in (others[row] for row in nearest):
        angle = (toward * unit(each.camera.center - points)).sum(-1).clamp(-1, 1).arccos().rad2deg()
        colors, shown = _seen(each, points)
        shown = shown & (own.depth > 0) & (angle > ANGLES[0]) & (angle < ANGLES[1])
        share = _mean(shown.float()[None], patch)[0]
        difference = _mean((colors - own.picture) * shown, patch) / share.clamp_min(1e-6)
        told = shown & (share > LEAST_SHARE)
        total += torch.where(told, difference.abs().mean(0), 0.0)
        count += told
    known = (count >= LEAST_VIEWS).float()
    score = _mean((total / count.clamp_min(1) * known)[None], around) / _mean(known[None], around).clamp_min(1e-6)
    return torch.where(known > 0, score[0], torch.nan)


def reflects(score: Tensor, height: int, width: int) -> Tensor:
    """Which pixels [H, W] reflect, by a score [h, w]; none where that is not known."""
    full = functional.interpolate(score.nan_to_num(0.0)[None, None], (height, width), mode="bilinear")[0, 0]
    return full > REFLECTS


def _seen(surface: Surface, points: Tensor) -> tuple[Tensor, Tensor]:
    """The picture's colors [3, h, w] at points [h, w, 3], and which of them nothing hides."""
    pixels, depths = surface.camera.project(points)
    at = pixels / pixels.new_tensor([surface.camera.width, surface.camera.height]) * 2 - 1
    grid = at.nan_to_num(9.0).clamp(-2, 2)[None]
    sampled = partial(functional.grid_sample, grid=grid, padding_mode="border", align_corners=False)
    colors = sampled(surface.picture[None])[0]
    nearest = sampled(surface.depth[None, None], mode="nearest")[0, 0]
    there = (depths > 0) & (at.abs() < 1).all(-1)
    return colors, there & ((nearest - depths).abs() < SAME * depths)


def _mean(values: Tensor, size: int) -> Tensor:
    """Over size × size pixels of [C, h, w]; beyond the border there is 0."""
    return functional.avg_pool2d(values[None], size, 1, size // 2)[0]


def _odd(size: float) -> int:
    return 2 * int(size / 2) + 1
