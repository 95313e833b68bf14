"""Which of a view's normals are learned: as agreed, and none of what is seen through a flat mirror or glass.

What a flat mirror or a pane shows lies behind its normals, and so do here and there the pictures of a curved mirror.
The one a base set draws as it draws any room, once no normals hold it to the glass. The other needs its normals. A
pilot run of some steps tells them apart, on views that it has not seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace

import torch
from torch import Tensor

from envgs_bench.core import Scene, View
from envgs_bench.core.normal_prior import NormalPrior, normals_outside, pixels_in, share_of
from envgs_bench.parts import TRANSMISSIVE

from ..method import Method
from .pilot_run import SHORTEST_RUN, smaller, train_briefly

NORMALS = "normals"  # in what pilot runs have found
HELD_OUT = 8  # every eighth training view, the fourth first, is drawn and not trained on
LEAST_GAIN = 0.5  # dB; what lies behind has 1.2 and more, curved mirrors have 0.25 at most


@dataclass(frozen=True)
class SeenThroughOutcome:
    """What leaving out the normals brought.

    Attributes:
        share: of what the training views show that was asked about.
        gain: how much nearer to the views held out it was drawn, in dB; 0 where they show none of it.
    """

    share: float
    gain: float

    @property
    def lies_behind(self) -> bool:
        return self.gain > LEAST_GAIN

    @property
    def sentence(self) -> str:
        found = (
            f"pilot run before the first step: {self.share:.0%} of what the training views show may lie behind its "
            f"normals, and is drawn {self.gain:+.2f} dB better without them; what does gains {LEAST_GAIN:+} dB and more"
        )
        return found + (": no normals are learned there" if self.lies_behind else "")


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
    def by(cls, prior: NormalPrior, outcome: SeenThroughOutcome) -> LearnedNormals:
        """Without the normals of what a pilot run found to lie behind them."""
        cells = prior.maybe_seen_through if outcome.lies_behind else {}
        return cls(prior, cells, [*prior.notes, outcome.sentence])

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
    scene: Scene, steps: int, agreed: bool, found: dict[str, dict[str, float]], fresh: Callable[[], Method]
) -> LearnedNormals:
    """None of what lies behind them: by a pilot run where there may be much and the run is long enough for one.

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
        found[NORMALS] = asdict(seen_through_pilot(scene, prior, fresh(), fresh()))
    return LearnedNormals.by(prior, SeenThroughOutcome(**found[NORMALS]))


def seen_through_pilot(scene: Scene, prior: NormalPrior, held: Method, free: Method) -> SeenThroughOutcome:
    """Train both methods on the training views, `free` without normals in what may be seen through; compare them there.

    Args:
        held, free: new, with the same settings and seed, that take normals as they are given.
    """
    cells = prior.maybe_seen_through
    starts = ((held, LearnedNormals(prior)), (free, LearnedNormals(prior, cells)))
    with_normals, without = (_held_out_error(method, scene, learned, cells) for method, learned in starts)
    gain = 10 * math.log10(with_normals / without) if with_normals > 0 and without > 0 else 0.0
    return SeenThroughOutcome(share_of(cells, len(scene.train)), gain)


def _held_out_error(method: Method, scene: Scene, learned: LearnedNormals, cells: Mapping[str, Tensor]) -> float:
    """The sum of squared errors in the cells of the views held out, once the method has learned the others."""
    small = [smaller(learned(view)) for view in scene.train]
    held_out = [index % HELD_OUT == HELD_OUT // 2 for index in range(len(small))]
    trained = [view for view, out in zip(small, held_out, strict=True) if not out]
    train_briefly(method, replace(scene, train=trained, test=[], val=[], normals=None))
    shown = (view for view, out in zip(small, held_out, strict=True) if out)
    return sum(_error(method, view, cells) for view in shown)


@torch.no_grad()
def _error(method: Method, view: View, cells: Mapping[str, Tensor]) -> float:
    """The sum of squared errors of the view's pixels in the cells."""
    if view.name not in cells:
        return 0.0
    error = (method.render(view.camera).color.clamp(0, 1).cpu() - view.rgb()).square().mean(dim=-1)
    return float(error[pixels_in(cells[view.name], *error.shape)].double().sum())
