"""Coverage: which parts of the pictures show something, and which of these the scene's points are in."""

from __future__ import annotations

import statistics

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, Scene, View

CELLS = 16  # columns, and rows, of cells of a picture that points should lie in
CONTRAST = 0.02  # deviation of gray values, in [0, 1], above which a cell shows something


@torch.no_grad()
def coverage(scene: Scene, near: float, device: torch.device | str = "cpu") -> float:
    """Of the cells that show something the share with a point, of the median view; 1 where no cell does.

    A cell of one color, a clear sky, shows nothing that a point could be found on.

    Args:
        device: where all pixels and points are looked at, much sooner on a GPU.
    """
    points = scene.points.detach().to(device).float()
    textured = torch.stack([_textured_cells(view, device) for view in scene.train]).cpu()
    empty = textured & ~torch.stack([_cells_with(points, view, near) for view in scene.train]).cpu()
    shares = 1 - empty.sum(dim=(1, 2)) / textured.sum(dim=(1, 2)).clamp_min(1)
    return statistics.median(shares.tolist())


def _cells_with(points: Tensor, view: View, near: float) -> Tensor:
    """Which cells of the view, [CELLS, CELLS] by rows and columns, would show any of the points."""
    found = torch.zeros(CELLS * CELLS + 1, dtype=torch.bool, device=points.device)
    found[cells_of(points, view.camera, near)] = True
    return found[:-1].reshape(CELLS, CELLS)


def cells_of(points: Tensor, camera: Camera, near: float) -> Tensor:
    """The cell that would show each of the points [P, 3], counted along the rows, [P]; CELLS² where none does."""
    at, depths = camera.to(points.device).project(points)
    width, height = camera.width / CELLS, camera.height / CELLS
    column, row = at[:, 0] / width, at[:, 1] / height
    shown = (depths > near) & (column >= 0) & (column < CELLS) & (row >= 0) & (row < CELLS)
    cell = torch.where(shown, row, 0.0).long() * CELLS + torch.where(shown, column, 0.0).long()
    return torch.where(shown, cell, CELLS * CELLS)


def _textured_cells(view: View, device: torch.device | str) -> Tensor:
    """Which cells of the view, [CELLS, CELLS], are not of one color: by the deviation of their gray values."""
    gray = view.rgb(device).mean(dim=-1)[None, None]
    mean, square = (functional.adaptive_avg_pool2d(values, CELLS)[0, 0] for values in (gray, gray.square()))
    return (square - mean.square()) > CONTRAST**2
