"""Exposure and white balance that change from view to view, told by the scene's points and taken back.

A point has one color, but for what view and light change. So of what a view shows at the points, in the logarithm of
linear light, an offset that all of them share is the view's own: its exposure and, channel by channel, its white
balance. Such are a camera's automatics; a method without a term for them blends views that contradict each other.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from .observations import Observations
from .thresholds import HALVES, UNEQUAL

DARKEST, BRIGHTEST = 10 / 255, 245 / 255  # sRGB values beyond which a factor of light is cut off or lost in rounding
LEAST_POINTS = 30  # that a view must show for its exposure to be judged
LEAST_VIEWS = 4  # that must show a point for its color to be theirs
WIDEST, TRIED = 3.0, 25  # offsets, as logarithms, that each view is first tried with
OTHER = 0.2  # difference of sRGB values from which a view shows something else
ROUNDS = 10
SPREAD = 1.5  # × the median difference: Geman and McClure's scale
LEAST_SCALE = 0.05  # of logarithms of light
LEAST_DEVIATION = 0.01  # of a point's: no point counts more than one of this
SURE = 0.25  # share of the points, those whose views agree best, that say how bright all views should be


@dataclass(frozen=True)
class Exposures:
    """How brightly training views were taken, each channel.

    Attributes:
        deviation: by how much the median view's linear light is off that of all, as a logarithm; 0 where unknown.
        disagreement: how differently halves of the points say so, as a share of it; infinite where not asked for.
        factors: by views' names the factors [3] by which their light is off; none where views are about equal.
    """

    deviation: float = 0.0
    disagreement: float = math.inf
    factors: Mapping[str, Tensor] = field(default_factory=dict)

    @property
    def stops(self) -> float:
        return self.deviation / math.log(2)


@dataclass(frozen=True)
class _Offsets:
    """What V views' logarithms of light share, beside those of P points.

    Attributes:
        offsets: [V, 3], each channel.
        judged: [V] whether the view shows points enough.
        common: [P, 3] the points' own logarithms of light.
    """

    offsets: Tensor
    judged: Tensor
    common: Tensor


@torch.no_grad()
def exposures(observations: Observations, device: torch.device | str = "cpu") -> Exposures:
    """Those of the observed views, as far as their points tell.

    An exposure is a factor on all that a view shows. A reflection is no such factor: it lies on some surfaces, and adds
    more to dark colors than to bright ones. So the points are halved along each axis of space, and by their brightness,
    and the halves have to say about the same of the views, in the median of the four.

    Args:
        device: where it is found; what is found is on the CPU.
    """
    seen, given = _seen(observations).to(device), observations.colors.to(device)
    found = None if observations.colorless else _offsets(seen, given)
    if found is None:
        return Exposures()
    deviation = float(_from_middle(found.offsets[found.judged]).median())
    if deviation < UNEQUAL:
        return Exposures(deviation)
    keys = (*observations.points.T.to(device), given.mean(dim=1))
    disagreement = statistics.median(_disagreement(seen, given, key <= key.median()) for key in keys)
    if disagreement > HALVES:
        return Exposures(deviation, disagreement)
    offsets, common = found.offsets, found.common
    off = found.judged & (_differences(seen, common + offsets[:, None]) < _differences(seen, common[None]))
    named = zip(observations.views, offsets.cpu(), off.tolist(), strict=True)
    return Exposures(deviation, disagreement, {view.name: offset.exp() for view, offset, is_off in named if is_off})


def _from_middle(offsets: Tensor) -> Tensor:
    """By how much each of the views' offsets [V, 3] is off the median, in the channel that is off most, [V]."""
    return (offsets - offsets.median(dim=0).values).abs().amax(dim=1)


def _disagreement(seen: Tensor, given: Tensor, half: Tensor) -> float:
    """The median view's difference of what two halves of the points say, over the median offset of their mean."""
    first, second = (_offsets(seen[:, rows], given[rows]) for rows in (half, ~half))
    if first is None or second is None:
        return math.inf
    both = first.judged & second.judged
    if both.sum() < LEAST_VIEWS:
        return math.inf
    one, other = first.offsets[both], second.offsets[both]
    mean = _from_middle(0.5 * (one + other)).median()
    return float(_from_middle(one - other).median() / mean.clamp_min(1e-6))


def _offsets(colors: Tensor, points: Tensor) -> _Offsets | None:
    """What the views show [V, P, 3] at points of these colors [P, 3] tells; None where that is nothing.

    In turn the views' offsets are found from the points' colors and the points' colors from the views, as weighted
    means of logarithms. Weights fall with the difference that is left, since something may lie before a point, and with
    the variance of what a point's views show, since some lie on fine texture or shine. How bright all views should be
    is said by the colors that came with the points.
    """
    valid = ((colors > DARKEST) & (colors < BRIGHTEST)).all(dim=-1)  # not where NaN
    judged, known = valid.sum(dim=1) >= LEAST_POINTS, valid.sum(dim=0) >= LEAST_VIEWS
    if not judged.any() or not known.any():
        return None
    seen = _light(torch.where(valid[..., None], colors, 0.5)).log()
    given = common = _light(points[None].clamp(DARKEST, BRIGHTEST))[0].log()
    offsets = _first(colors, common)
    for _ in range(ROUNDS):
        distance = (seen - offsets[:, None] - common).norm(dim=-1)
        scale = max(SPREAD * float(distance[valid].median()), LEAST_SCALE)
        weights = (valid / (1 + (distance / scale).square()).square())[..., None]
        variance = _mean((seen - offsets[:, None] - common).square(), weights, dim=0).sum(dim=-1, keepdim=True)
        offsets = _mean(seen - common, weights / variance.clamp_min(LEAST_DEVIATION**2), dim=1)
        common = torch.where(known[:, None], _mean(seen - offsets[:, None], weights, dim=0), common)
    differences = torch.where(valid, (seen - offsets[:, None] - common).norm(dim=-1), torch.nan)
    of_points = torch.where(known, differences.nanmedian(dim=0).values, torch.inf)
    sure = of_points <= of_points[known].quantile(SURE)
    brighter = (common - given)[sure].median(dim=0).values
    return _Offsets(offsets + brighter, judged, common - brighter)


def equalized(image: Tensor, factors: Tensor) -> Tensor:
    """A view's picture, [H, W, 3] bytes, with the linear light of its channels divided by the factors [3]."""
    from kornia.color import linear_rgb_to_rgb

    light = _light(image.float() / 255) / factors.to(image.device)
    encoded: Tensor = linear_rgb_to_rgb(light.clamp(0, 1).movedim(-1, -3)).movedim(-3, -1)
    return (255 * encoded).round().byte().contiguous()


def _seen(observations: Observations) -> Tensor:
    """What the views show around the points that nothing hides: sRGB of the mean light of 3×3 pixels, else NaN.

    A pixel of a fine texture is another from every view, and a point behind something has another's color.
    """
    from kornia.color import linear_rgb_to_rgb

    light = torch.stack([observations.around(index) for index in range(len(observations.views))])
    mean = _light((light.float() / 255).flatten(0, 1)).unflatten(0, light.shape[:2]).mean(dim=2)
    seen = linear_rgb_to_rgb(mean.movedim(-1, -3)).movedim(-3, -1)
    return torch.where(observations.unhidden[..., None], seen, torch.nan)


def _first(seen: Tensor, logs: Tensor) -> Tensor:
    """Of each view the offset, of all channels alike, at which it shows most points in their colors: [V, 3]."""
    tried = torch.linspace(-WIDEST, WIDEST, TRIED, device=seen.device)
    differences = [_differences(seen, (logs + offset)[None]) for offset in tried]
    return tried[torch.stack(differences).argmin(dim=0)][:, None].expand(-1, 3)


def _differences(seen: Tensor, logs: Tensor) -> Tensor:
    """How far what the views show at the points [V, P, 3] is from these logarithms of light, cut off as it is: [V].

    The logarithms are [V, P, 3], or [1, P, 3] for all views alike.
    """
    from kornia.color import linear_rgb_to_rgb

    expected = linear_rgb_to_rgb(logs.exp().clamp(0, 1).movedim(-1, -3)).movedim(-3, -1)
    difference = (expected - seen).abs().mean(dim=-1).clamp_max(OTHER)
    mean: Tensor = difference.nanmean(dim=1)
    return mean


def _mean(values: Tensor, weights: Tensor, dim: int) -> Tensor:
    return (weights * values).sum(dim=dim) / weights.sum(dim=dim).clamp_min(1e-6)


def _light(colors: Tensor) -> Tensor:
    """Linear light of sRGB colors [A, B, 3] in [0, 1]."""
    from kornia.color import rgb_to_linear_rgb

    light: Tensor = rgb_to_linear_rgb(colors.movedim(-1, -3)).movedim(-3, -1)
    return light
