"""Headline: of one data set, what the best reflecting method gains inside reflections, and what that costs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from envgs_bench.parts import REFLECTIVE

from .estimates import Estimate, Numbers

WITHOUT_REFLECTIONS = ("2dgs", "3dgs")  # kinds of methods whose reflections are color that depends on direction
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


def headline(numbers: Numbers, dataset: str, kinds: Mapping[str, str]) -> Headline | None:
    """The data set's headline; None where not both a method and a baseline finished.

    Args:
        kinds: method -> what its code is called in records.
    """
    region = REFLECTIVE if REFLECTIVE in numbers.regions((dataset,)) else "full"
    means = {method: _mean(numbers, dataset, method, "psnr", region) for method in kinds}
    plain = {m: mean for m, mean in means.items() if mean is not None and kinds[m] in WITHOUT_REFLECTIONS}
    others = {m: mean for m, mean in means.items() if mean is not None and m not in plain}
    if not plain or not others:
        return None
    method, baseline = max(others, key=lambda m: others[m]), max(plain, key=lambda m: plain[m])
    gain = numbers.estimate((dataset,), method, region, "psnr", baseline)
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
