"""Budgets in sentences: where a curve's knee is, and which cell of a map is best."""

from __future__ import annotations

import math
from collections.abc import Sequence

from .budgets import PRUNED, PSNR, TIED_DB, BudgetCurve, BudgetMap, BudgetRow


def limit_text(curve: BudgetCurve, row: BudgetRow) -> str:
    """The budget with its unit, as `4,000 primitives`, `0.5 MB`, `5 ms a frame` or `prune_error=0.05`."""
    if not math.isfinite(row.limit):
        return "no prunings" if curve.key == PRUNED else "no budget"
    if curve.key == PRUNED:
        return f"prune_error={row.limit:g}"
    if curve.key.endswith("primitives"):
        return f"{row.limit:,.0f} primitives"
    return f"{row.limit:g} {'MB' if curve.key.endswith('mb') else 'ms a frame'}"


def curve_sentence(curve: BudgetCurve) -> str:
    """Where the method's knee is, or why it has none."""
    knee = curve.knee
    if knee.row is None:
        best = f"; best: {limit_text(curve, knee.best)}" if knee.best else ""
        return f"{curve.method}: no knee, {knee.why}{best}."
    if knee.row == knee.best:
        return f"{curve.method}: {limit_text(curve, knee.row)}, the best; any less may lose more than {TIED_DB:g} dB."
    interval, mean = knee.loss.interval, knee.loss.mean
    assert interval is not None
    assert mean is not None
    assert knee.best is not None
    return (
        f"{curve.method}: {limit_text(curve, knee.row)}, {-mean:.2f} dB below the best "
        f"({limit_text(curve, knee.best)}), by the interval at most {max(0.0, -interval.low):.2f}."
    )


def rate_sentence(curve: BudgetCurve, curves: Sequence[BudgetCurve]) -> str:
    """The BD-rate of primitives against the first curve within budgets of the same kind; "" where there is none."""
    anchor = next(other for other in curves if other.key == curve.key)
    rate = None if curve is anchor else curve.rate_against(anchor)
    if rate is None:
        return ""
    more = "more" if rate >= 0 else "fewer"
    return f"{curve.method}: {abs(rate):.0%} {more} primitives than {anchor.method} at equal PSNR (BD-rate)."


def map_sentence(found: BudgetMap) -> str:
    """Which size limits were best, and which smaller ones are as good."""
    if found.best is None:
        return f"{found.method}: no run finished."
    base, env = found.best
    mean = found.estimate(base, env).mean
    words = f"{found.method}: best with at most {base:,} in the base and {env:,} in the environment, {mean:.2f} dB"
    if found.knee is None:
        return f"{words}."
    lost = found.estimate(*found.knee, PSNR, found.best)
    assert lost.mean is not None
    base, env = found.knee
    return f"{words}; {base:,} and {env:,} are {-lost.mean:.2f} below."
