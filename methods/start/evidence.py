"""What the photographs say of a scene's points, normals and views, before anything has been trained on them.

Points that structure from motion found have the colors of the pictures that show them, and are wherever the pictures
show something; what the estimators of normals saw from two sides is one surface. No data set has to say so.
"""

from __future__ import annotations

import statistics
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Camera, Scene, View
from envgs_bench.core.vectors import unit

POINTS = 4_000  # points that are looked at
CELLS = 16  # columns, and rows, of cells of a picture that points should lie in
CONTRAST = 0.02  # deviation of gray values, in [0, 1], above which a cell shows something
LIKELY = 0.25  # quantile of the differences to a point's color over the views, most of which may not see it
COLORLESS = 0.02  # mean difference of points' colors below which they come without: 3DGS's random points are all gray
SAME_COLOR = 0.1  # mean difference of sRGB values up to which a view shows a point
PARALLAX_POINTS = 300
NORMAL_POINTS = 1_500
NORMAL_PAIRS = 500  # pairs of a point's normals that must be there to be judged
BESIDE = 12.0  # degrees up to which two views see a point from one side: hardly anything hides it from one alone
MIRROR_PAIRS = 1_000  # points that a view must share with others, times these views, for its normals to be judged
MIRROR_GAIN = 0.03  # by how much the mean cosine to others' normals must rise when a view's are mirrored
MIRROR_ROUNDS = 10


@dataclass(frozen=True)
class Evidence:
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
    def of(cls, scene: Scene, near: float, most: int = POINTS) -> Evidence:
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
    def seen_colors(self) -> Tensor:
        """What the views show where the points would be, [V, P, 3] in [0, 1]; NaN outside."""
        maps = (view.image for view in self.views)
        return torch.stack([self._at(index, values).float() / 255 for index, values in enumerate(maps)])

    def support(self) -> float:
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

    def normals_unmirrored(self, mirrored: Collection[str]) -> Tensor:
        """`seen_normals`, those of the views named mirrored from left to right."""
        normals = zip(self.seen_normals, self.views, strict=True)
        return torch.stack([mirrored_normals(own, view) if view.name in mirrored else own for own, view in normals])

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
            found.append(self._at(index, view.normal).nan_to_num(0.0) * same[:, None])
        return torch.stack(found)

    def mirrored_views(self) -> list[str]:
        """Names of the views whose normals agree better with the others' once they are mirrored from left to right.

        What a view and another one say of the same point has to be one normal, and a wrong convention of axes leaves
        them apart unless the cameras' axes are parallel. Starting from none and from all of them, each view in turn
        takes the side that agrees better with all others, until none changes.
        """
        agreement, pairs = self._agreement()
        judged = pairs.sum(dim=1) >= MIRROR_PAIRS
        if not judged.any():
            return []
        sides = [self._sides(agreement, judged, first) for first in (0, 1)]
        none = torch.zeros_like(sides[0])
        best = max([none, *sides], key=lambda side: _total(agreement, side))
        if _total(agreement, best) < _total(agreement, none) + MIRROR_GAIN * float(pairs.sum()):
            return []
        return [view.name for view, mirrored in zip(self.views, best.tolist(), strict=True) if mirrored]

    def _agreement(self) -> tuple[Tensor, Tensor]:
        """Σ of cosines of two views' normals [V, 2, V, 2], as they are and mirrored, and of how many points [V, V]."""
        normals = self.seen_normals
        mirrored = [mirrored_normals(normal, view) for normal, view in zip(normals, self.views, strict=True)]
        sides, counted = torch.stack([normals, torch.stack(mirrored)], dim=1), normals.any(dim=-1).float()
        count = len(self.views)
        flat = sides.reshape(2 * count, -1)
        agreement, pairs = (flat @ flat.T).reshape(count, 2, count, 2), counted @ counted.T
        each = torch.arange(count)
        agreement[each, :, each], pairs[each, each] = 0, 0
        return agreement, pairs

    @staticmethod
    def _sides(agreement: Tensor, judged: Tensor, first: int) -> Tensor:
        each = torch.arange(len(judged))
        side = torch.where(judged, first, 0)
        for _ in range(MIRROR_ROUNDS):
            before = side.clone()
            for index in each[judged].tolist():
                side[index] = agreement[index][:, each, side].sum(dim=1).argmax()
            if bool((side == before).all()):
                break
        return side

    def _at(self, index: int, values: Tensor) -> Tensor:
        """What a map [H, W, C] of a view holds where the points are, [P, C] as float; NaN outside."""
        shown = self.shown[index]
        columns, rows = torch.where(shown[:, None], self.pixels[index], 0.0).long().unbind(dim=1)
        return torch.where(shown[:, None], values[rows, columns].float(), torch.nan)


def _total(agreement: Tensor, side: Tensor) -> float:
    each = torch.arange(len(side))
    return float(agreement[each[:, None], side[:, None], each[None], side[None]].sum())


def mirrored_normals(normal: Tensor, view: View) -> Tensor:
    """Normals [..., 3] mirrored from left to right in the axes of the view's camera."""
    right = view.camera.world_to_camera[0, :3].to(normal)
    return normal - 2 * (normal @ right)[..., None] * right


@torch.no_grad()
def empty_cells(scene: Scene, near: float, device: torch.device | str = "cpu") -> tuple[Tensor, float]:
    """Which cells of each view show something and none of the scene's points; and the share that has some.

    A cell of one color, a clear sky, shows nothing that a point could be found on.

    Args:
        device: where all pixels and points are looked at, much sooner on a GPU.

    Returns:
        [V, CELLS, CELLS] by rows and columns, on the CPU; and of the cells that show something the share with a point,
        of the median view: 1 where no cell does.
    """
    points = scene.points.detach().to(device).float()
    textured = torch.stack([_textured_cells(view, device) for view in scene.train]).cpu()
    empty = textured & ~torch.stack([cells_with(points, view, near) for view in scene.train]).cpu()
    shares = 1 - empty.sum(dim=(1, 2)) / textured.sum(dim=(1, 2)).clamp_min(1)
    return empty, statistics.median(shares.tolist())


def cells_with(points: Tensor, view: View, near: float) -> Tensor:
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
