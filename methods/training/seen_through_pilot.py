"""Which of a view's normals are learned: as agreed, and none of what is seen through a flat mirror or glass.

What a flat mirror or a pane shows lies behind its normals, and so do here and there the pictures of a curved mirror.
The one a base set draws as it draws any room, once no normals hold it to the glass. The other needs its normals. Two
pilot runs of some steps tell where: one with all normals and one without any, compared place by place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from envgs_bench.core import Scene, View
from envgs_bench.core.normal_prior import NormalPrior, normals_outside, pixels_in, share_of
from envgs_bench.parts import TRANSMISSIVE

from ..method import Method
from .pilot_run import SHORTEST_RUN, smaller, train_briefly
from .places import sums_by_place

NORMALS = "normals"  # in what pilot runs have found
HELD_OUT = 8  # every eighth training view, from the fifth, is drawn and not trained on
CELLS = 16  # of a view along either axis, without normals or with them
PLACE = 0.2  # × the scene radius: the edge of a place
LEAST_GAIN = 0.5  # dB that a place gains without normals, from which on it has none …
LEAST_SHARE = 0.05  # … where so much of what views show of it is likely to lie behind


@dataclass(frozen=True)
class LearnedNormals:
    """A training view -> the view with the normals that are learned, on the device it is on.

    Attributes:
        prior: whose normals in agreement they are; None: as they are given.
        left_out: by views' names the cells without normals.
        notes: what is learned otherwise than given, a sentence each.
        glass: by views' names the pixels [H, W] without normals, where masks are given.
    """

    prior: NormalPrior | None = None
    left_out: Mapping[str, Tensor] = field(default_factory=dict)
    notes: Sequence[str] = ()
    glass: Mapping[str, Tensor] = field(default_factory=dict)

    @classmethod
    def of(cls, prior: NormalPrior, views: int) -> LearnedNormals:
        """Without the normals in what nothing but a mirror or glass looks like, of so many training views."""
        cells = prior.seen_through
        if not cells:
            return cls(prior, notes=prior.notes)
        said = (
            f"learns no normals from {share_of(cells, views):.0%} of what the training views show, which lies behind "
            "them, as what flat mirrors show does"
        )
        return cls(prior, cells, [*prior.notes, said])

    @classmethod
    def by(cls, prior: NormalPrior, cells: Mapping[str, Tensor], views: int) -> LearnedNormals:
        """Without the normals in the cells that pilot runs draw better so, of so many training views."""
        said = (
            f"pilot run before the first step: {share_of(cells, views):.0%} of what the training views show is drawn "
            f"better by {LEAST_GAIN} dB and more without normals, and learns none"
        )
        return cls(prior, cells, [*prior.notes, said])

    def outside_glass(self, scene: Scene) -> LearnedNormals:
        """Without those of what the training views' masks call transmissive: what shows there lies behind them."""
        glass = {view.name: mask for view in scene.train if (mask := view.masks.get(TRANSMISSIVE)) is not None}
        if not any(mask.any() for mask in glass.values()):
            return self
        said = "learns no normals of what masks call transmissive: what shows there lies behind them"
        return replace(self, glass=glass, notes=[*self.notes, said])

    @property
    def weight(self) -> float:
        return self.prior.weight if self.prior is not None else 1.0

    def __call__(self, view: View) -> View:
        if self.prior is not None:
            view = self.prior.agreed(view)
        if view.normal is not None and view.name in self.left_out:
            view = replace(view, normal=normals_outside(view.normal, self.left_out[view.name]))
        if view.normal is not None and view.name in self.glass:
            glass = self.glass[view.name].to(view.normal.device)[..., None]
            view = replace(view, normal=torch.where(glass, 0.0, view.normal))
        return view


def learned_normals(
    scene: Scene, steps: int, agreed: bool, found: dict[str, dict[str, Any]], fresh: Callable[[], Method]
) -> LearnedNormals:
    """None of what lies behind them: by pilot runs where there may be much and the run is long enough for these.

    Args:
        agreed: whether the method learns from normals in agreement.
        found: what pilot runs have found so far, by name; this one is added.
        fresh: makes a new method that takes normals as they are given.
    """
    prior = scene.normals if agreed else None
    if prior is None:
        return LearnedNormals()
    if not prior.maybe_seen_through or steps < SHORTEST_RUN:
        return LearnedNormals.of(prior, len(scene.train))
    if NORMALS not in found:
        found[NORMALS] = better_without(scene, prior, fresh(), fresh())
    return LearnedNormals.by(prior, found[NORMALS], len(scene.train))


def better_without(scene: Scene, prior: NormalPrior, held: Method, free: Method) -> dict[str, Tensor]:
    """Train both methods on the training views, `free` without any normals; where it draws better, as `left_out`.

    Of that only places of which views show some as what may lie behind: a matt wall gains in so short a run, too.
    Every eighth view is held out of both trainings. All views are drawn and compared, those that were trained on too.

    Args:
        held, free: new, with the same settings and seed, that take normals as they are given.
    """
    small = [smaller(prior.agreed(view)) for view in scene.train]
    without = [view if view.normal is None else replace(view, normal=torch.zeros_like(view.normal)) for view in small]
    for method, views in ((held, small), (free, without)):
        trained = [view for index, view in enumerate(views) if index % HELD_OUT != HELD_OUT // 2]
        train_briefly(method, replace(scene, train=trained, test=[], val=[], normals=None))
    drawn = (_drawn(view, prior, held, free) for view in small)
    points, numbers = (torch.cat(parts, dim=-1) for parts in zip(*drawn, strict=True))
    seen, behind, before, after = sums_by_place(points.T, numbers, PLACE * scene.radius)
    gains = (before > 10 ** (LEAST_GAIN / 10) * after) & (behind > LEAST_SHARE * seen)
    sizes = [view.camera.height * view.camera.width for view in small]
    left_out = {}
    for view, pixels in zip(small, gains.split(sizes), strict=True):
        cells = functional.adaptive_avg_pool2d(pixels.float().reshape(1, view.camera.height, -1), CELLS)[0] > 0.5
        if cells.any():
            left_out[view.name] = cells
    return left_out


@torch.no_grad()
def _drawn(view: View, prior: NormalPrior, held: Method, free: Method) -> tuple[Tensor, Tensor]:
    """Where `held` draws each pixel of a view [3, P], and of it four numbers [4, P], on the CPU.

    They are 1, whether it may lie behind, and the squared errors of `held` and `free`.
    """
    drawn, target = held.render(view.camera), view.rgb()
    origins, directions = view.camera.rays()
    points = origins + drawn.depth.cpu().reshape(*directions.shape[:2], 1) * directions
    likely = prior.maybe_seen_through.get(view.name, torch.zeros(CELLS, CELLS, dtype=torch.bool))
    behind = pixels_in(likely, *target.shape[:2]).float()
    colors = (drawn.color, free.render(view.camera).color)
    before, after = ((color.clamp(0, 1).cpu() - target).square().mean(dim=-1) for color in colors)
    numbers = torch.stack([torch.ones_like(behind), behind, before, after])
    return points.reshape(-1, 3).T, numbers.flatten(1)
