"""Mean corruption error: one figure a method over all perturbations, after Hendrycks and Dietterich 2019.

Of each data set and kind of perturbation, the errors of all severities are summed and divided by the baseline's sum;
the mean of these ratios is the figure. Below 1 a method bears perturbations better than the baseline. Their error is a
classifier's; ours is the root of the mean squared error of the pictures, 10^(−PSNR / 20), and 1 of a run that failed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .perturbed_runs import value
from .stability import Case, Stability

WORST = 1.0  # the error of a picture that is white where it should be black


def mean_corruption_error(stability: Stability, method: str) -> tuple[float, int] | None:
    """The figure, and of how many data sets and kinds it is the mean; None where no baseline ran beside the method."""
    ratios = []
    for case in stability.cases:
        baseline = stability.baseline(case)
        if baseline is None or not stability.severities(case):
            continue
        errors = [_errors(stability, case, name) for name in (method, baseline)]
        both = errors[0].keys() & errors[1].keys()
        if both and sum(errors[1][severity] for severity in both) > 0:
            own, theirs = (sum(found[severity] for severity in both) for found in errors)
            ratios.append(own / theirs)
    return (float(np.mean(ratios)), len(ratios)) if ratios else None


def _errors(stability: Stability, case: Case, method: str) -> dict[int, float]:
    """The mean error of each severity that was tried."""
    found = {}
    for severity in stability.severities(case):
        tried: Sequence[float] = [_error(value(t.run, "psnr")) for t in stability.cell(case, severity, method).tried]
        if tried:
            found[severity] = float(np.mean(tried))
    return found


def _error(psnr: float | None) -> float:
    return WORST if psnr is None else min(WORST, 10 ** (-psnr / 20))
