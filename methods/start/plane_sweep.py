"""Points from photographs alone, where structure from motion left none: a sparse plane sweep (Collins, CVPR 1996).

A pixel's depth is that at which the patch around it looks alike in the nearest other views. It is taken for known
only where all other depths look clearly worse, so that neither walls without texture nor curved mirrors get points.

What is too far away for a depth, a sky, looks alike in whatever views show its direction. The nearest mostly do not:
cameras around a scene that move by a tenth of it turn by six degrees. So all views are asked for that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, View

WIDTH = 160  # pixels: pictures at least twice as wide are reduced, by a whole factor, to less than twice this
NEIGHBORS = 4  # other views that a patch is looked for in
AGREEING = 2  # of them that must show it: others may see something in front
PATCH = 2  # pixels of the reduced picture between a patch's 3 × 3 samples
DEPTHS = 64  # in geometric progression, of a first sweep over all depths
FINER = 9  # of a second one around the best of them
CLEARLY = 0.6  # × the least difference at any other depth is the most that a match may have
LEAST_CONTRAST = 0.01  # by how much other depths must look worse, of the range of sRGB
OTHERWISE = 2  # depths beside the best that are no others
INFINITY = 1e4  # × the farthest depth
DISTANT = 4  # pixels by which the nearest views show what is at infinity beside what is at a depth that is another


@dataclass(frozen=True)
class _Reduced:
    """A view as it is swept: its picture [1, 3, h, w], narrower than 2·WIDTH."""

    camera: Camera
    picture: Tensor

    def colors(self, points: Tensor) -> Tensor:
        """The picture's colors at the points [..., 3], NaN where it does not show them; [..., 3]."""
        pixels, depths = self.camera.project(points.reshape(-1, 3))
        at = pixels / pixels.new_tensor([self.camera.width, self.camera.height]) * 2 - 1
        sampled = functional.grid_sample(
            self.picture, at[None, None].clamp(-2, 2), padding_mode="border", align_corners=False
        )
        shown = (depths > 0) & (at.abs() < 1).all(-1)
        return torch.where(shown[:, None], sampled[0, :, 0].T, torch.nan).reshape(points.shape)


@torch.no_grad()
def swept_points(
    views: Sequence[View],
    wanted: Sequence[Tensor],
    near: float,
    far: float,
    generator: torch.Generator,
    device: torch.device,
) -> tuple[Tensor, Tensor]:
    """Points [P, 3], world frame, and their colors [P, 3] in [0, 1], sRGB, on the CPU.

    Args:
        wanted: pixel positions (x, y) [K, 2] in each view whose depth is looked for; many of them have none to find.
        near, far: depths between which it lies, world units, 0 < near < far.
        generator: for the depths, up to `far`, of what is at infinity as far as views can tell.
    """
    reduced = [_reduced(view, device) for view in views]
    centers = torch.stack([each.camera.center for each in reduced])
    axes = torch.stack([each.camera.world_to_camera[2, :3] for each in reduced])
    found: list[tuple[Tensor, Tensor]] = [(torch.zeros(0, 3), torch.zeros(0, 3))]
    for index, pixels in enumerate(wanted):
        if not len(pixels):
            continue
        view, others = reduced[index], [reduced[row] for row in _nearest(centers, axes, index)]
        if len(others) >= AGREEING:
            everywhere = reduced[:index] + reduced[index + 1 :]
            points = _swept(view, others, everywhere, pixels.to(device), near, far, generator)
            found.append((points.cpu(), view.colors(points).nan_to_num(0.5).cpu()))
    points, colors = (torch.cat(parts) for parts in zip(*found, strict=True))
    return points, colors


def _reduced(view: View, device: torch.device) -> _Reduced:
    picture = view.rgb(device).permute(2, 0, 1)[None]
    factor = view.camera.width // WIDTH
    if factor > 1:
        size = (max(1, round(view.camera.height / factor)), round(view.camera.width / factor))
        picture = functional.interpolate(picture, size, mode="area")
    return _Reduced(view.camera.to(device), picture)


def _nearest(centers: Tensor, axes: Tensor, index: int) -> list[int]:
    """The views nearest to one of them that look in about the same direction."""
    distance = (centers - centers[index]).norm(dim=1)
    usable = (axes @ axes[index] > 0.5) & (distance > 1e-6)
    order = torch.where(usable, distance, torch.inf).argsort()[: min(NEIGHBORS, int(usable.sum()))]
    return order.tolist()


def _swept(
    view: _Reduced,
    others: list[_Reduced],
    everywhere: list[_Reduced],
    pixels: Tensor,
    near: float,
    far: float,
    generator: torch.Generator,
) -> Tensor:
    """Points of those of the pixels [K, 2] whose depth is clear, or that are clearly too far away to have one."""
    step = (far / near) ** (1 / (DEPTHS - 1))
    coarse = near * step ** torch.arange(DEPTHS, device=pixels.device)
    differences = _differences(view, others, pixels, coarse.expand(len(pixels), -1))
    at_infinity = _differences(view, everywhere, pixels, pixels.new_full((len(pixels), 1), INFINITY * far))[:, 0]

    nearest_distant = min(max(_distant_from(view, others), near), far)
    nearby = torch.where(coarse < nearest_distant, differences, torch.inf).amin(dim=1)
    least, best = differences.min(dim=1)
    elsewhere = (torch.arange(DEPTHS, device=pixels.device) - best[:, None]).abs() > OTHERWISE
    other = torch.where(elsewhere, differences, torch.inf).amin(dim=1)
    clear = (best > 0) & (best < DEPTHS - 1) & _clearly(least, other) & (least < CLEARLY * at_infinity)
    distant = ~clear & _clearly(at_infinity, nearby)

    fine = coarse[best[clear]][:, None] * step ** torch.linspace(-1, 1, FINER, device=pixels.device)
    finest = _differences(view, others, pixels[clear], fine).argmin(dim=1)[:, None]
    drawn = torch.rand(int(distant.sum()), generator=generator).to(pixels)
    depths = torch.cat([fine.gather(1, finest)[:, 0], nearest_distant * (far / nearest_distant) ** drawn])
    directions = _directions(view.camera, torch.cat([pixels[clear], pixels[distant]]))
    return view.camera.center + depths[:, None] * directions


def _clearly(least: Tensor, other: Tensor) -> Tensor:
    return other.isfinite() & (least < CLEARLY * other) & (other - least > LEAST_CONTRAST)


def _distant_from(view: _Reduced, others: list[_Reduced]) -> float:
    """The depth from which on the other views show something at most DISTANT pixels beside what is at infinity."""
    baseline = torch.stack([(other.camera.center - view.camera.center).norm() for other in others]).median()
    focal = view.camera.intrinsics[0, 0] * view.picture.shape[3] / view.camera.width
    return float(baseline * focal / DISTANT)


def _differences(view: _Reduced, others: list[_Reduced], pixels: Tensor, depths: Tensor) -> Tensor:
    """How differently the patches around the pixels [K, 2] look in other views at the depths [K, D], [K, D].

    The mean absolute difference over the patch in the views that agree best, infinite where too few show all of it.
    """
    scale = view.camera.width / view.picture.shape[3]
    around = torch.cartesian_prod(*2 * [torch.arange(-1, 2, device=pixels.device)]) * PATCH * scale
    patch = pixels[:, None] + around  # [K, 9, 2]
    directions = _directions(view.camera, patch.reshape(-1, 2)).reshape(len(pixels), 1, len(around), 3)
    points = view.camera.center + depths[:, :, None, None] * directions  # [K, D, 9, 3]
    own = view.colors(view.camera.center + depths[:, :1, None, None] * directions)
    each = torch.stack([(other.colors(points) - own).abs().mean(dim=(-1, -2)) for other in others])
    return each.nan_to_num(torch.inf).sort(dim=0).values[:AGREEING].mean(dim=0)


def _directions(camera: Camera, pixels: Tensor) -> Tensor:
    """World-frame directions [K, 3] through the pixel positions [K, 2], camera z = 1."""
    return functional.pad(pixels, (0, 1), value=1.0) @ camera.pixel_to_direction().T
