"""BD-rate: how many more primitives, or bytes, a curve takes than another at equal quality (Bjøntegaard 2001)."""

from __future__ import annotations

import math
from collections.abc import Iterable

FEWEST_POINTS = 3  # of a curve

Point = tuple[float, float]  # rate > 0, and quality, of which more is better


def bd_rate(points: Iterable[Point], anchor: Iterable[Point]) -> float | None:
    """The mean difference of log-rate over the qualities that both curves reach, as a share: −0.5 is half the rate.

    Between points log-rate is a monotone cubic of quality (PCHIP), which makes no bends of its own. A point that a
    smaller rate's is as good as is left out. None where a curve has fewer than FEWEST_POINTS left, or they share no
    quality.
    """
    from scipy.interpolate import PchipInterpolator  # takes half a second to import

    curves = [_rising(curve) for curve in (points, anchor)]
    if min(map(len, curves)) < FEWEST_POINTS:
        return None
    low = max(curve[0][1] for curve in curves)
    high = min(curve[-1][1] for curve in curves)
    if not low < high:
        return None
    means = []
    for curve in curves:
        log_rate = PchipInterpolator([quality for _, quality in curve], [math.log(rate) for rate, _ in curve])
        means.append(float(log_rate.integrate(low, high)) / (high - low))
    return math.expm1(means[0] - means[1])


def _rising(points: Iterable[Point]) -> list[Point]:
    """By ascending rate, those that are better than all before."""
    kept: list[Point] = []
    for point in sorted(points):
        if not kept or point[1] > kept[-1][1]:
            kept.append(point)
    return kept
