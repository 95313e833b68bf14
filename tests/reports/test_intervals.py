"""Intervals against scipy's: Student's of one stratum, Welch's of two, Brunner and Munzel's of ranks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from envgs_bench.reports.numbers.intervals import Interval, interval_around, mean_interval


def interval_of(strata) -> Interval:
    interval = mean_interval(strata)
    assert interval is not None
    return interval


def test_of_one_stratum_it_is_scipys_and_of_two_welchs():
    values = [26.1, 26.9, 26.3]
    expected = stats.ttest_1samp(values, 0).confidence_interval(0.95)
    assert mean_interval([values]) == pytest.approx((expected.low, expected.high))
    others = [31.0, 30.2, 30.8, 33.0]
    welch = stats.ttest_ind(values, [-value for value in others], equal_var=False).confidence_interval(0.95)
    assert mean_interval([values, others]) == pytest.approx((welch.low / 2, welch.high / 2))  # of the sum, halved


def test_of_three_seeds_it_holds_the_mean_as_often_as_it_says_and_a_bootstrap_does_not():
    random = np.random.default_rng(7)
    runs = [[random.normal(mean, spread, 3) for mean, spread in ((1.0, 0.1), (2.0, 0.3))] for _ in range(400)]
    student = np.mean([one.low <= 1.5 <= one.high for one in map(interval_of, runs)])
    assert 0.92 < student < 0.99  # Welch's degrees of freedom err on the safe side
    bootstraps = (
        stats.bootstrap(strata, mean_of_means, n_resamples=200, method="percentile", rng=random).confidence_interval
        for strata in runs
    )
    assert np.mean([found.low <= 1.5 <= found.high for found in bootstraps]) < 0.87


def mean_of_means(*strata, axis=-1):
    return sum(values.mean(axis=axis) for values in strata) / len(strata)


def test_differences_between_scenes_do_not_widen_the_interval():
    """Two scenes, 20 and 35 dB, each known to 0.01 dB: so is their mean."""
    noise = np.random.default_rng(0).normal(0, 0.01, (2, 10))
    interval = interval_of([20 + noise[0], 35 + noise[1]])
    assert (interval.low + interval.high) / 2 == pytest.approx(27.5, abs=0.01)
    assert interval.high - interval.low < 0.02
    pooled = interval_of([np.concatenate([20 + noise[0], 35 + noise[1]])])
    assert pooled.high - pooled.low > 5


def test_scenes_count_alike_whatever_their_number_of_seeds():
    assert interval_of([[10.0, 10.0], [20.0] * 50]) == (15, 15)


@given(st.lists(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=6), min_size=1, max_size=4))
def test_the_interval_holds_the_mean_and_more_at_higher_coverage(strata):
    wide, narrow = interval_of(strata), mean_interval(strata, coverage=0.5)
    assert narrow is not None
    mean = np.mean([np.mean(values) for values in strata])
    slack = 1e-9 * (1 + max(abs(value) for values in strata for value in values))
    assert wide.low <= narrow.low <= mean + slack
    assert mean - slack <= narrow.high <= wide.high


def test_it_has_no_width_where_nothing_varies_and_there_is_none_of_too_few():
    assert mean_interval([[2.0, 2.0], [3.0, 3.0]]) == (2.5, 2.5)
    assert mean_interval([]) is None
    assert mean_interval([[1.0, 2.0], [3.0]]) is None
    with pytest.raises(ValueError, match="not finite"):
        mean_interval([[1.0, float("inf")]])


def test_it_scales_with_its_values_down_to_where_squares_of_their_variances_are_0():
    values = [[1.0, 2.0, 4.0], [1.0, 3.0, 2.0]]
    tiny, ordinary = mean_interval(np.multiply(values, 1e-100)), interval_of(values)
    assert tiny is not None
    assert np.divide(tiny, 1e-100) == pytest.approx(ordinary)


def test_of_ranks_it_is_brunner_and_munzels():
    """Its interval of the share of won pairs ends at a half just where scipy's test is at 5 %."""
    random = np.random.default_rng(3)
    x, y = random.normal(0.6, 1, 9), random.normal(0, 2, 12)
    better = x[:, None] > y[None]
    shares = [better.mean(axis=1), better.mean(axis=0)]
    variances = np.array([share.var(ddof=1) / len(share) for share in shares])
    freedom = np.array([len(share) - 1 for share in shares])
    p = stats.brunnermunzel(x, y).pvalue
    interval = interval_around(float(better.mean()), variances, freedom, coverage=1 - p)
    assert min(abs(end - 0.5) for end in interval) == pytest.approx(0, abs=1e-9)


def test_a_share_ends_at_0_and_1():
    assert Interval(-0.2, 0.7).within(0, 1) == (0, 0.7)
    assert Interval(0.4, 1.3).within(0, 1) == (0.4, 1)
