"""A trial of windows: whether views show more truly where no normals are learned from what may lie behind them.

What a flat mirror or a pane shows lies behind its normals, and so do here and there the pictures of a curved mirror
(`start.windows`). The one a base set draws as it draws any room, once no normals hold it to the glass. The other needs
its normals. A training of some steps tells them apart, on views that it has not seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from envgs_bench.core import View

from .method import Method
from .start.mending import Mended, MendedViews
from .start.windows import inside, share_of
from .training.pilot_run import smaller, train_briefly

HELD_OUT = 8  # every eighth training view, the fourth first, is drawn and not trained on
LEAST_GAIN = 0.5  # dB; what lies behind has 1.2 and more, curved mirrors have 0.25 at most


@dataclass(frozen=True)
class WindowsOutcome:
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
            f"trial before the first step: {self.share:.0%} of what the training views show may lie behind its normals,"
            f" and is drawn {self.gain:+.2f} dB better without them; windows do from {LEAST_GAIN:+} dB on"
        )
        return found + (": no normals are learned there" if self.lies_behind else "")


def windows_trial(found: Mended, held: Method, free: Method) -> WindowsOutcome:
    """Train both methods on the training views, `free` without normals in likely windows, and compare them there.

    Args:
        found: what a run starts from.
        held, free: new, with the same settings and seed, and nothing mended by themselves.
    """
    cells = found.windows.likely
    starts = ((held, found.views), (free, replace(found.views, windows=cells)))
    with_normals, without = (_held_out_error(method, found, views) for method, views in starts)
    gain = 10 * math.log10(with_normals / without) if with_normals > 0 and without > 0 else 0.0
    return WindowsOutcome(share_of(cells, len(found.scene.train)), gain)


def _held_out_error(method: Method, found: Mended, views: MendedViews) -> float:
    """The sum of squared errors in likely windows of the views held out, once the method has learned the others.

    Args:
        views: what becomes of the training views.
    """
    small = [smaller(views(view)) for view in found.scene.train]
    held_out = [index % HELD_OUT == HELD_OUT // 2 for index in range(len(small))]
    learned = [view for view, out in zip(small, held_out, strict=True) if not out]
    train_briefly(method, replace(found.scene, train=learned, test=[], val=[]))
    shown = (view for view, out in zip(small, held_out, strict=True) if out)
    return sum(_error(method, view, found.windows.likely) for view in shown)


@torch.no_grad()
def _error(method: Method, view: View, cells: Mapping[str, Tensor]) -> float:
    """The sum of squared errors of the view's pixels in the cells."""
    if view.name not in cells:
        return 0.0
    error = (method.render(view.camera).color.clamp(0, 1).cpu() - view.rgb()).square().mean(dim=-1)
    return float(error[inside(cells[view.name], *error.shape)].double().sum())
