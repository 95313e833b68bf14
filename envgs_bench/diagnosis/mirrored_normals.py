"""Normals that follow another convention of axes: mirrored from left to right, in some views or in all.

What a view and another one say of the same point has to be one normal, and a wrong convention of axes leaves them apart
unless the cameras' axes are parallel.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import torch
from torch import Tensor

from envgs_bench.core import View

from .observations import Observations
from .thresholds import MIRROR_ALIKE, MIRROR_GAIN, MIRROR_PAIRS

ROUNDS = 10


@dataclass(frozen=True)
class Mirrored:
    """Views whose normals agree better with the others' once they are mirrored from left to right.

    Attributes:
        views: their names.
        gain: how much better all views' normals then agree, 0 to 1, of the mean over pairs; 0 where too few can tell.
    """

    views: list[str]
    gain: float


def mirrored_views(observations: Observations) -> Mirrored:
    """Those of a scene; none where the gain is below `MIRROR_GAIN`.

    Starting from none and from all of them, each view in turn takes the side that agrees better with all others, until
    none changes.
    """
    agreement, pairs = _agreement(observations)
    judged = pairs.sum(dim=1) >= MIRROR_PAIRS
    if not judged.any():
        return Mirrored([], 0.0)
    sides = [_sides(agreement, judged, first) for first in (0, 1)]
    none = torch.zeros_like(sides[0])
    best = max([none, *sides], key=lambda side: _total(agreement, side))
    gain = (_total(agreement, best) - _total(agreement, none)) / float(pairs.sum())
    if gain < MIRROR_GAIN:
        return Mirrored([], gain)
    return Mirrored([view.name for view, other in zip(observations.views, best.tolist(), strict=True) if other], gain)


def normals_unmirrored(observations: Observations, mirrored: Collection[str]) -> Tensor:
    """The views' normals at the points [V, P, 3], those of the views named mirrored from left to right."""
    normals = zip(observations.seen_normals, observations.views, strict=True)
    return torch.stack([mirrored_normals(own, view) if view.name in mirrored else own for own, view in normals])


def mirrored_normals(normal: Tensor, view: View) -> Tensor:
    """Normals [..., 3] mirrored from left to right in the axes of the view's camera."""
    right = view.camera.world_to_camera[0, :3].to(normal)
    return normal - 2 * (normal @ right)[..., None] * right


def _agreement(observations: Observations) -> tuple[Tensor, Tensor]:
    """How well two views' normals agree [V, 2, V, 2], as they are and mirrored, and at how many points [V, V].

    A pair counts by how far its cosine is above `MIRROR_ALIKE`, 1 where both are the same. Normals that are farther
    apart than that are of two things, one seen through glass or past the other, and tell nothing of either view.
    """
    normals, views = observations.seen_normals * observations.unhidden[..., None], observations.views
    mirrored = [mirrored_normals(normal, view) for normal, view in zip(normals, views, strict=True)]
    sides, seen = torch.stack([normals, torch.stack(mirrored)], dim=1), normals.any(dim=-1)
    agreement = []
    for own, shown in zip(sides, seen, strict=True):
        cosines = torch.einsum("skc,vtkc->svtk", own[:, shown], sides[:, :, shown])
        agreement.append(((cosines - MIRROR_ALIKE).clamp_min(0) / (1 - MIRROR_ALIKE)).sum(dim=-1))
    found, pairs = torch.stack(agreement), seen.float() @ seen.float().T
    each = torch.arange(len(views))
    found[each, :, each], pairs[each, each] = 0, 0
    return found, pairs


def _sides(agreement: Tensor, judged: Tensor, first: int) -> Tensor:
    each = torch.arange(len(judged))
    side = torch.where(judged, first, 0)
    for _ in range(ROUNDS):
        before = side.clone()
        for index in each[judged].tolist():
            side[index] = agreement[index][:, each, side].sum(dim=1).argmax()
        if bool((side == before).all()):
            break
    return side


def _total(agreement: Tensor, side: Tensor) -> float:
    each = torch.arange(len(side))
    return float(agreement[each[:, None], side[:, None], each[None], side[None]].sum())
