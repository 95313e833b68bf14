"""Points that structure from motion left wrong or missing, found by a plane sweep over the training views.

Where it failed (points that the pictures do not support, none where the pictures show something, at the cameras'
centers), other points take their place; where it found all but what is far away, a sky, that alone is added.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from envgs_bench.core import Scene, View

from .coverage import CELLS, cells_with, empty_cells
from .observations import Observations
from .plane_sweep import depth_range, swept_points
from .thresholds import FAR_MISSING, MIN_POINTS, MISSING, UNSUPPORTED

FAR = 1.5  # distance from every camera beyond which a point is far away, × the scene radius
PER_CELL = 3  # pixels of each empty cell of a view that are swept
TRIED = 4  # × as many are drawn, and those with the strongest gradients are taken


@torch.no_grad()
def repaired_points(scene: Scene, near: float, generator: torch.Generator, device: torch.device) -> Scene:
    """The scene with other points where those it has cannot be trained on, else the scene itself."""
    sound = without_points_at_cameras(scene, near)
    if len(sound.points) and Observations.of(sound, near).photo_consistency() < UNSUPPORTED:
        sound = _with(sound, torch.zeros(0, dtype=torch.long))
    empty, covered = empty_cells(sound, near, device)
    if covered >= MISSING:
        return scene
    started = _joined(sound, *_swept(scene, empty, near, generator, device))
    return started if len(started.points) >= MIN_POINTS else scene


@torch.no_grad()
def with_far_points(scene: Scene, near: float, generator: torch.Generator, device: torch.device) -> Scene:
    """The scene with points far away where most of what is there has none, a sky, else the scene itself.

    Of a sky structure from motion may find nothing and of all else enough. Then primitives before the cameras have to
    show it. The generator is as before if nothing is added.
    """
    empty, _ = empty_cells(scene, near, device)
    farther = FAR * (scene.radius or 1.0)
    known = scene.points.detach().to(device).float()
    is_far = _from_cameras(known, scene) > farther
    far, near_by = known[is_far], known[~is_far]
    only_far = (cells_with(far, view, near) & ~cells_with(near_by, view, near) for view in scene.train)
    least = max(FAR_MISSING * empty.numel(), 1 + sum(int(cells.sum()) for cells in only_far))  # cells to be missed
    if empty.sum() < least:
        return scene
    state = generator.get_state()
    points, colors = _swept(scene, empty, near, generator, device)
    is_far = _from_cameras(points, scene) > farther
    points, colors = points[is_far], colors[is_far]
    found = points.to(device)
    missed = sum(
        int((cells_with(found, view, near).cpu() & where).sum()) for view, where in zip(scene.train, empty, strict=True)
    )
    if missed < least:
        generator.set_state(state)
        return scene
    return _joined(scene, points, colors)


def without_points_at_cameras(scene: Scene, near: float) -> Scene:
    """The scene without points that lie nearer than `near` to any training camera's center."""
    distances = _from_cameras(scene.points.detach().cpu().float(), scene)
    return _with(scene, torch.nonzero(distances >= near)[:, 0])


def _from_cameras(points: Tensor, scene: Scene) -> Tensor:
    """Distances [P] of the points [P, 3] to the nearest training camera's center."""
    nearest = points.new_full((len(points),), torch.inf)
    for view in scene.train:
        nearest = torch.minimum(nearest, (points - view.camera.center.to(points)).norm(dim=1))
    return nearest


def _swept(
    scene: Scene, empty: Tensor, near: float, generator: torch.Generator, device: torch.device
) -> tuple[Tensor, Tensor]:
    """Points [P, 3] of what the training views show in their empty cells [V, CELLS, CELLS], and their colors [P, 3]."""
    wanted = [_strongest(view, where, generator) for view, where in zip(scene.train, empty, strict=True)]
    return swept_points(scene.train, wanted, *depth_range(scene, near), generator, device)


def _joined(scene: Scene, points: Tensor, colors: Tensor) -> Scene:
    """The scene with the points [P, 3] and their colors [P, 3] beside its own."""
    return replace(
        scene,
        points=torch.cat([scene.points.float(), points]),
        point_colors=torch.cat([scene.point_colors.float(), colors]),
    )


def _with(scene: Scene, rows: Tensor) -> Scene:
    if len(rows) == len(scene.points):
        return scene
    return replace(scene, points=scene.points[rows], point_colors=scene.point_colors[rows])


def _strongest(view: View, empty: Tensor, generator: torch.Generator) -> Tensor:
    """Pixel positions [K, 2] in the empty cells [CELLS, CELLS], where the picture changes most: PER_CELL a cell."""
    where = torch.nonzero(empty)  # [C, 2], rows and columns
    size = torch.tensor([view.camera.height, view.camera.width])
    drawn = torch.rand(len(where), PER_CELL * TRIED, 2, generator=generator)
    pixels = ((where[:, None] + drawn) / CELLS * size).long().minimum(size - 1)
    gray = view.rgb().mean(dim=-1)
    gradient = torch.stack(torch.gradient(gray)).square().sum(dim=0) if min(gray.shape) > 1 else gray
    rows, columns = pixels.unbind(dim=-1)
    best = gradient[rows, columns].topk(PER_CELL, dim=1).indices
    chosen = pixels.gather(1, best[..., None].expand(-1, -1, 2)).reshape(-1, 2).unique(dim=0)
    return chosen.flip(-1).float() + 0.5
