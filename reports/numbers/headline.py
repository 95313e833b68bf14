"""Headline: of one data set, what the best reflecting method gains inside reflections, and what that costs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from envgs_bench.parts import REFLECTIVE

from .comparison import compare
from .estimates import Estimate, Numbers

COSTS = ("frame_ms", "train_seconds", "primitives")


@dataclass(frozen=True)
class Headline:
    """The most accurate method that draws reflections, against the most accurate one that draws none."""

    dataset: str
    region: str  # REFLECTIVE, or "full" where the data set does not know what reflects
    method: str
    baseline: str
    gain: Estimate  # in PSNR, dB, paired by seed
    costs: dict[str, tuple[float, float]]  # of COSTS those that both have: the method's, the baseline's


def headline(numbers: Numbers, dataset: str, reflects: Mapping[str, bool]) -> Headline | None:
    """The data set's headline; None where not both a method and a baseline finished.

    Args:
        reflects: row -> whether it models reflections; without those of which nobody says.
    """
    region = REFLECTIVE if REFLECTIVE in numbers.regions((dataset,)) else "full"
    means = {m: mean for m in reflects if (mean := _mean(numbers, dataset, m, "psnr", region)) is not None}
    plain = {m: mean for m, mean in means.items() if not reflects[m]}
    others = {m: mean for m, mean in means.items() if reflects[m]}
    if not plain or not others:
        return None
    method, baseline = max(others, key=lambda m: others[m]), max(plain, key=lambda m: plain[m])
    gain = compare(numbers, (dataset,), method, baseline, "psnr", region).difference
    if gain.mean is None:
        return None
    costs = {}
    for cost in COSTS:
        ours, theirs = _mean(numbers, dataset, method, cost), _mean(numbers, dataset, baseline, cost)
        if ours and theirs:
            costs[cost] = ours, theirs
    return Headline(dataset, region, method, baseline, gain, costs)


def _mean(numbers: Numbers, dataset: str, method: str, metric: str, region: str = "full") -> float | None:
    mean = numbers.estimate((dataset,), method, region, metric).mean
    return None if mean is None else float(mean)
