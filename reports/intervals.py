"""How far a mean over seeds can be trusted: a stratified bootstrap with a fixed generator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

DRAWS = 1000
COVERAGE = 0.95


def bootstrap_interval(strata: Sequence[Sequence[float]]) -> tuple[float, float] | None:
    """The 95 % percentile interval of the unweighted mean of the strata's means.

    Args:
        strata: the values over seeds of each data set; seeds are resampled within their data set only.

    Returns:
        (low, high), or None where some stratum has fewer than two values: one run says nothing of spread.
    """
    if not strata or min(len(values) for values in strata) < 2:
        return None
    generator = np.random.default_rng(0)
    total = np.zeros(DRAWS)
    for values in strata:
        picks = generator.integers(len(values), size=(DRAWS, len(values)))
        total += np.asarray(values, dtype=np.float64)[picks].mean(axis=1)
    tail = (1 - COVERAGE) / 2
    low, high = np.quantile(total / len(strata), [tail, 1 - tail])
    return float(low), float(high)


def overlap(a: tuple[float, float] | None, b: tuple[float, float] | None) -> bool:
    """Whether two intervals share a point; False where either is unknown."""
    return a is not None and b is not None and a[0] <= b[1] and b[0] <= a[1]
