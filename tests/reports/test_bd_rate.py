"""BD-rate against closed forms: curves that are shifted, cross, bend and hardly overlap."""

from __future__ import annotations

import math

import pytest

from envgs_bench.reports.studies.budgets.bd_rate import bd_rate

ANCHOR = [(1000.0 * 2**k, 20.0 + 3 * math.sqrt(k)) for k in range(5)]


@pytest.mark.parametrize("factor", [0.5, 1.0, 1.75])
def test_a_curve_of_so_many_times_the_rate(factor: float) -> None:
    assert bd_rate([(factor * rate, quality) for rate, quality in ANCHOR], ANCHOR) == pytest.approx(factor - 1)


def test_curves_that_are_straight_in_log_rate() -> None:
    """log₂ rate is q and 2q − 3: equal at 3, and over [2, 5] the mean difference is 1/2 of a doubling."""
    line = [(2.0**q, q) for q in (1.0, 2.0, 4.0, 5.0)]
    steeper = [(2.0 ** (2 * q - 3), q) for q in (2.0, 3.0, 4.0, 6.0)]
    assert bd_rate(steeper, line) == pytest.approx(math.sqrt(2) - 1)
    assert bd_rate(line, steeper) == pytest.approx(1 / math.sqrt(2) - 1)


def test_a_point_that_a_smaller_rate_is_as_good_as_does_not_count() -> None:
    assert bd_rate([*ANCHOR, (50_000.0, 21.0), (3000.0, 20.0)], ANCHOR) == pytest.approx(0.0)


@pytest.mark.parametrize("points", [[], ANCHOR[:2], [(r, q + 100) for r, q in ANCHOR], [(1e3, 25.0)] * 4])
def test_there_is_none_where_nothing_compares(points: list[tuple[float, float]]) -> None:
    assert bd_rate(points, ANCHOR) is None
