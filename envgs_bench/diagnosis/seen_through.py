"""Regions seen through flat mirrors or glass: the normals there are the glass's, and what is shown lies behind it.

The normals that an estimator, or a scanner, has of a mirror are its glass's. If that is flat, what it shows stands
still behind it, and photographs have depths of it as of any room; what a curved mirror shows moves with the eye and is
found in few places. A base set draws such a room as it draws others, unless the normals hold it to the glass.

Between two points of a surface its normals are about the same, and the points lie along these. Behind glass they do
not. That is asked of random pairs of pixels whose depths a plane sweep makes out, of all views together. Where few of
them lie steeply behind, or not so steeply, it may be a curved mirror, whose normals a method needs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from envgs_bench.core import View
from envgs_bench.core.vectors import unit

from .coverage import CELLS, cells_of
from .observations import SAME_COLOR
from .plane_sweep import PlaneSweep, SweptView

PAIRS = 400  # that are drawn in each view
APART = 0.1  # picture widths from one pixel of a pair to the other
BETWEEN = 5  # pixels between them whose normals are to be the same too
ALIKE = 0.95  # cosine above which two normals are about the same
IN_ORDER = 2.0  # pairs that are not steep, which every cell has besides its own
AROUND = 1.5  # cells, the deviation of the Gaussian by which a cell counts pairs around it


@dataclass(frozen=True)
class Criterion:
    """When a cell is seen through a mirror or glass.

    Attributes:
        steep: degrees to the surface beyond which two points do not lie along it: depths are good to 15 or so.
        most: share of pairs that are steep beyond which it does.
    """

    steep: float
    most: float


SURE, LIKELY = Criterion(45.0, 0.5), Criterion(30.0, 0.3)


@dataclass(frozen=True)
class SeenThrough:
    """Cells seen through mirrors or glass, [CELLS, CELLS] by rows and columns, on the CPU; by names of views with any.

    Attributes:
        sure: what nothing else looks like.
        likely: these, and what curved mirrors look like here and there.
    """

    sure: Mapping[str, Tensor] = field(default_factory=dict)
    likely: Mapping[str, Tensor] = field(default_factory=dict)


@dataclass(frozen=True)
class _Pairs:
    """K pairs of a view's pixels between which all normals are about the same.

    Attributes:
        first, second: [K, 2] pixel positions (x, y).
        normals: [K, 3] unit.
    """

    first: Tensor
    second: Tensor
    normals: Tensor

    @classmethod
    def of(cls, view: View, normals: Tensor, generator: torch.Generator, device: torch.device) -> _Pairs:
        """Those among PAIRS random ones, by the view's normals [H, W, 3]."""
        size = torch.tensor([view.camera.width, view.camera.height])
        first = torch.rand(PAIRS, 2, generator=generator) * size
        angle = 2 * torch.pi * torch.rand(PAIRS, generator=generator)
        second = first + APART * view.camera.width * torch.stack([angle.cos(), angle.sin()], dim=1)
        inside = (second >= 0).all(dim=1) & (second < size).all(dim=1)
        first, second = first[inside].floor() + 0.5, second[inside].floor() + 0.5
        along = first + torch.linspace(0, 1, BETWEEN + 2)[:, None, None] * (second - first)
        columns, rows = along.long().to(normals.device).unbind(dim=-1)
        each = normals[rows, columns].to(device).float()  # [BETWEEN + 2, K, 3]
        mean = unit(each[0] + each[-1])
        alike = ((each * mean).sum(dim=-1) > ALIKE).all(dim=0)
        return cls(first.to(device)[alike], second.to(device)[alike], mean[alike])

    def those(self, wanted: Tensor) -> _Pairs:
        return _Pairs(self.first[wanted], self.second[wanted], self.normals[wanted])


@torch.no_grad()
def seen_through(views: Iterable[View], near: float, far: float, device: torch.device) -> SeenThrough:
    """Which parts of the views are seen through mirrors or glass.

    Args:
        views: asked for one at a time.
        near, far: depths between which something is looked for, world units, 0 < near < far.
    """
    generator = torch.Generator().manual_seed(0)
    names, swept, pairs = [], [], {}
    for index, view in enumerate(views):
        names.append(view.name)
        swept.append(SweptView.of(view, device))
        if view.normal is not None:
            pairs[index] = _Pairs.of(view, view.normal, generator, device)
    sweep = PlaneSweep(swept, near, far)
    found = [_points(sweep, index, each) for index, each in pairs.items() if sweep.neighbors[index]]
    if not found:
        return SeenThrough()
    points, colors, angles = (torch.cat(parts) for parts in zip(*found, strict=True))
    sure, likely = dict[str, Tensor](), dict[str, Tensor]()
    for index in pairs:
        each = _cells(sweep.views[index], near, points, colors, angles)
        for cells, where in zip((sure, likely), each, strict=True):
            if where.any():
                cells[names[index]] = where.cpu()
    return SeenThrough(sure, likely)


def _points(sweep: PlaneSweep, index: int, pairs: _Pairs) -> tuple[Tensor, Tensor, Tensor]:
    """What a view shows at its pairs, [P, 3], in which colors [P, 3], and a pair's degrees to its surface [P]."""
    matches = sweep.matches(index, pairs.first)
    pairs, nearest = pairs.those(matches.clear), matches.best[matches.clear]
    matches = sweep.matches(index, pairs.second)
    pairs, best = pairs.those(matches.clear), (nearest[matches.clear], matches.best[matches.clear])
    each = zip((pairs.first, pairs.second), best, strict=True)
    first, second = (sweep.points(index, pixels, sweep.finer(index, pixels, depth)) for pixels, depth in each)
    sine = (unit(second - first) * pairs.normals).sum(dim=1).abs()
    angle = sine.clamp(max=1).asin().rad2deg()
    points = torch.cat([first, second])
    return points, sweep.views[index].colors(points), angle.repeat(2)


def _cells(view: SweptView, near: float, points: Tensor, colors: Tensor, angles: Tensor) -> list[Tensor]:
    """Which cells of the view surely and likely are, by the points [P, 3] that it shows in their colors.

    Each is [CELLS, CELLS].
    """
    shown = (view.colors(points) - colors).abs().mean(dim=1) < SAME_COLOR  # of NaN: no
    cells = cells_of(points, view.camera, near)
    row = torch.arange(CELLS, device=points.device)
    around = torch.exp(-0.5 * ((row[:, None] - row) / AROUND).square())

    def counted(those: Tensor) -> Tensor:
        count = torch.bincount(cells[those], minlength=CELLS * CELLS + 1)[:-1]
        return around @ count.reshape(CELLS, CELLS).float() @ around

    pairs = counted(shown) + IN_ORDER
    return [counted(shown & (angles > each.steep)) > each.most * pairs for each in (SURE, LIKELY)]
