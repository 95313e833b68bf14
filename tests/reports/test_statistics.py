"""The bootstrap against scipy's, against its closed form for many values, and on strata; so Student's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from envgs_bench.reports.numbers.statistics import Interval, bootstrap_interval, t_interval

VALUES = np.random.default_rng(3).normal(27.0, 2.0, 24)


def interval_of(strata, **options) -> Interval:
    interval = bootstrap_interval(strata, **options)
    assert interval is not None
    return interval


def test_one_stratum_is_scipys_percentile_bootstrap():
    interval = interval_of([VALUES], draws=20_000)
    expected = stats.bootstrap(
        (VALUES,), np.mean, n_resamples=20_000, method="percentile", rng=np.random.default_rng(1)
    ).confidence_interval
    standard_error = VALUES.std() / len(VALUES) ** 0.5
    assert interval.low == pytest.approx(expected.low, abs=0.05 * standard_error)
    assert interval.high == pytest.approx(expected.high, abs=0.05 * standard_error)


def test_many_values_give_the_normal_interval():
    values = np.random.default_rng(0).uniform(0, 1, 1000)
    interval = interval_of([values], draws=5000)
    half = stats.norm.ppf(0.975) * values.std() / len(values) ** 0.5
    assert interval.high - values.mean() == pytest.approx(half, rel=0.06)
    assert values.mean() - interval.low == pytest.approx(half, rel=0.06)


def test_differences_between_scenes_do_not_widen_the_interval():
    """Two scenes, 20 and 35 dB, each known to 0.01 dB: so is their mean."""
    noise = np.random.default_rng(0).normal(0, 0.01, (2, 10))
    interval = interval_of([20 + noise[0], 35 + noise[1]])
    assert (interval.low + interval.high) / 2 == pytest.approx(27.5, abs=0.01)
    assert interval.high - interval.low < 0.02
    pooled = interval_of([np.concatenate([20 + noise[0], 35 + noise[1]])])
    assert pooled.high - pooled.low > 5


def test_scenes_count_alike_whatever_their_number_of_views():
    interval = interval_of([[10.0, 10.0], [20.0] * 50])
    assert interval == (15, 15)


def test_the_same_values_give_the_same_interval():
    assert interval_of([VALUES]) == interval_of([VALUES])
    assert interval_of([VALUES], seed=1) != interval_of([VALUES])


@given(st.lists(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=6), min_size=1, max_size=4))
def test_the_interval_lies_within_the_values_and_holds_more_at_higher_coverage(strata):
    wide = interval_of(strata, draws=200)
    narrow = interval_of(strata, coverage=0.5, draws=200)
    slack = 1e-9 * (1 + max(abs(value) for values in strata for value in values))
    assert wide.low <= narrow.low <= narrow.high <= wide.high
    assert np.mean([min(values) for values in strata]) - slack <= wide.low
    assert wide.high <= np.mean([max(values) for values in strata]) + slack


def test_too_few_values_have_no_interval_and_non_finite_ones_are_refused():
    assert bootstrap_interval([]) is None
    assert bootstrap_interval([[1.0, 2.0], [3.0]]) is None
    with pytest.raises(ValueError, match="not finite"):
        bootstrap_interval([[1.0, float("nan")]])


def test_students_interval_of_one_stratum_is_scipys_and_of_two_welchs():
    values = [26.1, 26.9, 26.3]
    expected = stats.ttest_1samp(values, 0).confidence_interval(0.95)
    assert t_interval([values]) == pytest.approx((expected.low, expected.high))
    others = [31.0, 30.2, 30.8, 33.0]
    welch = stats.ttest_ind(values, [-value for value in others], equal_var=False).confidence_interval(0.95)
    assert t_interval([values, others]) == pytest.approx((welch.low / 2, welch.high / 2))  # of the sum, halved


def test_students_interval_of_three_seeds_holds_the_mean_as_often_as_it_says_and_the_bootstraps_does_not():
    random = np.random.default_rng(7)
    runs = [[random.normal(mean, spread, 3) for mean, spread in ((1.0, 0.1), (2.0, 0.3))] for _ in range(400)]
    found = [(t_interval(strata), bootstrap_interval(strata, draws=200)) for strata in runs]
    student, bootstrap = (np.mean([one.low <= 1.5 <= one.high for one in each]) for each in zip(*found, strict=True))
    assert 0.92 < student < 0.99  # Welch's degrees of freedom err on the safe side
    assert bootstrap < 0.87


def test_students_interval_has_no_width_where_nothing_varies_and_none_of_too_few():
    assert t_interval([[2.0, 2.0], [3.0, 3.0]]) == (2.5, 2.5)
    assert t_interval([]) is None
    assert t_interval([[1.0, 2.0], [3.0]]) is None
    with pytest.raises(ValueError, match="not finite"):
        t_interval([[1.0, float("inf")]])


def test_students_interval_scales_with_its_values_down_to_where_squares_of_their_variances_are_0():
    values = [[1.0, 2.0, 4.0], [1.0, 3.0, 2.0]]
    tiny, ordinary = t_interval(np.multiply(values, 1e-100)), t_interval(values)
    assert tiny is not None
    assert ordinary is not None
    assert np.divide(tiny, 1e-100) == pytest.approx(ordinary)


def test_intervals_overlap_where_they_share_a_point():
    assert Interval(26.0, 27.0).overlaps(Interval(27.0, 28.0))
    assert Interval(26.0, 29.0).overlaps(Interval(27.0, 28.0))
    assert not Interval(26.0, 26.9).overlaps(Interval(27.0, 28.0))
