"""Observations: what the training views show at a scene's points, before anything has been trained on them.

Points that structure from motion found have the colors of the pictures that show them, and what estimators of normals
saw there from two sides is one surface. No data set has to say so.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from envgs_bench.core import Scene, View
from envgs_bench.core.vectors import unit

from .coverage import CELLS

POINTS = 4_000  # points that are looked at
HIDDEN = 1.1  # × the depth of the nearest point in a cell: something may be in front of points that are farther
LIKELY = 0.25  # quantile of the differences to a point's color over the views, most of which may not see it
COLORLESS = 0.02  # mean difference of points' colors below which they come without: 3DGS's random points are all gray
SAME_COLOR = 0.1  # mean difference of sRGB values up to which a view shows a point
PARALLAX_POINTS = 300
NORMAL_POINTS = 1_500
NORMAL_PAIRS = 500  # pairs of a point's normals that must be there to be judged
BESIDE = 12.0  # degrees up to which two views see a point from one side: hardly anything hides it from one alone


@dataclass(frozen=True)
class Observations:
    """Points of a scene, evenly over the order in which they come, and where the training views would show them.

    Attributes:
        views: V training views.
        points, colors: [P, 3], world frame, and in [0, 1], sRGB.
        pixels: [V, P, 2] pixel positions.
        shown: [V, P] whether the point lies inside the picture and beyond `near`, be it hidden or not.
    """

    views: Sequence[View]
    points: Tensor
    colors: Tensor
    pixels: Tensor
    shown: Tensor

    @classmethod
    @torch.no_grad()
    def of(cls, scene: Scene, near: float, most: int = POINTS) -> Observations:
        """That of at most `most` of the scene's points, all on the CPU; `near` is the nearest depth that is drawn."""
        count = len(scene.points)
        rows = torch.linspace(0, count - 1, min(count, most)).round().long()
        rows = rows.clamp_max(count - 1)  # float32 rounds beyond the last of more than 2²⁴ points
        points = scene.points[rows].detach().cpu().float()
        pixels, shown = [], []
        for view in scene.train:
            at, depths = view.camera.project(points)
            size = at.new_tensor([view.camera.width, view.camera.height])
            shown.append((depths > near) & (at >= 0).all(dim=1) & (at < size).all(dim=1))
            pixels.append(at)
        colors = scene.point_colors[rows].detach().cpu().float()
        return cls(scene.train, points, colors, torch.stack(pixels), torch.stack(shown))

    @cached_property
    def unhidden(self) -> Tensor:
        """Which of the shown points [V, P] are not well behind the nearest in their part of the picture."""
        return torch.stack([self._in_front(index) for index in range(len(self.views))])

    def _in_front(self, index: int) -> Tensor:
        shown, camera = self.shown[index], self.views[index].camera
        depths = self.points @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
        size = depths.new_tensor([camera.width, camera.height])
        column, row = torch.where(shown[:, None], self.pixels[index] / size * CELLS, 0.0).long().unbind(dim=1)
        cell = row * CELLS + column
        depths = torch.where(shown, depths, torch.inf)
        nearest = torch.full((CELLS**2,), torch.inf).scatter_reduce(0, cell, depths, "amin")
        return shown & (depths <= HIDDEN * nearest[cell])

    @cached_property
    def seen_colors(self) -> Tensor:
        """What the views show where the points would be, [V, P, 3] in [0, 1]; NaN outside."""
        maps = (view.image for view in self.views)
        return torch.stack([self.sampled(index, values).float() / 255 for index, values in enumerate(maps)])

    def hidden_share(self, near: float) -> float:
        """Share of the points in the median view's picture that are nearer than `near`, world units; 0 of no points."""
        shares = []
        for view, pixels in zip(self.views, self.pixels, strict=True):
            depths = view.camera.project(self.points)[1]
            size = pixels.new_tensor([view.camera.width, view.camera.height])
            inside = depths[(depths > 0) & (pixels >= 0).all(dim=1) & (pixels < size).all(dim=1)]
            shares.append((inside < near).float().mean() if len(inside) else pixels.new_zeros(()))
        return float(torch.stack(shares).median())

    def photo_consistency(self) -> float:
        """How much nearer the points' colors are to what views show there than other points' are: 0 by chance, to 1.

        Of each point the lower quartile over the views counts, since something may be in front of it. 1 where all
        points have about one color: nothing speaks against them.
        """
        if not self.shown.any():
            return 0.0
        if self.colorless:
            return 1.0
        own, others = (self._difference(colors) for colors in (self.colors, self._shuffled_colors))
        return 1 - own / max(others, 1e-6)

    @property
    def colorless(self) -> bool:
        """Whether all points have about one color, so that theirs say nothing of points or views."""
        return float((self.colors - self._shuffled_colors).abs().mean()) < COLORLESS

    @property
    def _shuffled_colors(self) -> Tensor:
        return self.colors[torch.randperm(len(self.colors), generator=torch.Generator().manual_seed(0))]

    def _difference(self, colors: Tensor) -> float:
        known = self.shown.any(dim=0)
        differences = (self.seen_colors - colors).abs().mean(dim=-1)[:, known]
        return float(differences.nanquantile(LIKELY, dim=0).mean())

    def parallax(self) -> float:
        """By how many degrees a point is usually seen from another side in the nearest other view that has it.

        The median over points and the views that show them; 180 where no other one does.
        """
        rows = self._some(PARALLAX_POINTS)
        shown = self.shown[:, rows]
        nearest = self._nearest(rows, shown)
        angles = torch.cat([beside[own] for (beside, _), own in zip(nearest, shown, strict=True)])
        return float(angles.median()) if len(angles) else 180.0

    def normal_disagreement(self, normals: Tensor) -> float:
        """By how many degrees two views' normals [V, P, 3] of a point usually differ; 0 where too few pairs can tell.

        Of each view and point that it shows, the nearest other view counts that has a normal there, if it is within
        `BESIDE` degrees; of the angles the median. Where views err independently it is about √2 times their error.
        Points of one color do not tell which views show them.
        """
        if self.colorless:
            return 0.0
        rows = self._some(NORMAL_POINTS)
        normals = normals[:, rows]
        differences = []
        for own, (angles, other) in zip(normals, self._nearest(rows, normals.any(dim=-1)), strict=True):
            both = own.any(dim=-1) & (angles < BESIDE)
            cosines = (own * normals[other, torch.arange(len(rows))]).sum(dim=-1)[both]
            differences.append(cosines.clamp(-1, 1).acos().rad2deg())
        found = torch.cat(differences)
        return float(found.median()) if len(found) >= NORMAL_PAIRS else 0.0

    def _some(self, most: int) -> Tensor:
        """Indices of at most so many of the points, evenly over their order."""
        return torch.linspace(0, len(self.points) - 1, min(len(self.points), most)).round().long()

    def _nearest(self, rows: Tensor, seen: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
        """Of each view: by how many degrees beside the nearest other view sees each of the points `rows`, and which.

        180 degrees where none does. `seen` is [V, len(rows)].
        """
        centers = torch.stack([view.camera.center for view in self.views])
        directions = unit(self.points[rows] - centers[:, None])  # [V, P, 3]
        for index, own in enumerate(directions):
            cosines = torch.where(seen, (directions * own).sum(-1), -1.0)
            cosines[index] = -1
            nearest, other = cosines.max(dim=0)
            yield nearest.clamp(-1, 1).acos().rad2deg(), other

    @cached_property
    def seen_normals(self) -> Tensor:
        """The views' own normals where they show the points in their colors, [V, P, 3] world frame; elsewhere 0."""
        found = []
        for index, view in enumerate(self.views):
            if view.normal is None:
                found.append(torch.zeros(len(self.points), 3))
                continue
            same = (self.seen_colors[index] - self.colors).abs().mean(dim=-1) < SAME_COLOR
            found.append(self.sampled(index, view.normal).nan_to_num(0.0) * same[:, None])
        return torch.stack(found)

    def sampled(self, index: int, values: Tensor) -> Tensor:
        """What a map [H, W, C] of a view holds where the points are, [P, C] as float; NaN outside."""
        rows, columns = self._at(index)
        return torch.where(self.shown[index][:, None], values[rows, columns].float(), torch.nan)

    def around(self, index: int) -> Tensor:
        """The view's bytes in the 3×3 pixels around the points, [P, 9, 3]; those at the border again beyond it."""
        rows, columns = self._at(index)
        image = self.views[index].image
        offsets = torch.arange(-1, 2)
        near = (rows[:, None] + offsets).clamp(0, image.shape[0] - 1)[:, :, None]
        beside = (columns[:, None] + offsets).clamp(0, image.shape[1] - 1)[:, None]
        return image[near, beside].flatten(1, 2)

    def _at(self, index: int) -> tuple[Tensor, Tensor]:
        """The rows and columns of the view's pixels that show the points; 0 where none does."""
        columns, rows = torch.where(self.shown[index][:, None], self.pixels[index], 0.0).long().unbind(dim=1)
        return rows, columns
