"""The one comparison: paired by data set and seed, scipy's interval, and its rules for better, as good and tied."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from envgs_bench.reports.numbers.comparison import FEWEST_SEEDS, Comparison, compare
from envgs_bench.reports.numbers.estimates import Numbers

Values = dict[tuple[str, str], tuple[float, ...]]  # (data set, method) -> a value a seed


def numbers_of(values: Values) -> Numbers:
    rows = [(d, m, seed, "full", "psnr", value) for (d, m), own in values.items() for seed, value in enumerate(own)]
    tidy = pd.DataFrame(rows, columns=["dataset", "method", "seed", "region", "metric", "value"])
    return Numbers(tidy, tidy.assign(status="ok")[["dataset", "method", "seed", "status"]])


def compared(values: Values, sign: int = 1) -> Comparison:
    datasets = tuple(dict.fromkeys(dataset for dataset, _ in values))
    return compare(numbers_of(values), datasets, "a", "b", "psnr", sign=sign)


def test_seeds_of_one_data_set_are_paired_as_scipy_pairs_them() -> None:
    a, b = (20.0, 25.2, 30.1), (19.0, 24.5, 28.9)
    found = compared({("room", "a"): a, ("room", "b"): b})
    expected = stats.ttest_rel(a, b).confidence_interval(0.95)
    assert found.gain == pytest.approx((expected.low, expected.high))
    assert found.better()
    assert not stats.ttest_ind(a, b).pvalue < 0.05  # who does not pair sees nothing


def test_data_sets_are_averaged_with_welchs_degrees_of_freedom() -> None:
    values = {("room", "a"): (20.0, 20.4, 20.1), ("room", "b"): (19.5, 19.6, 19.9)}
    values |= {("sky", "a"): (30.0, 31.0, 30.2), ("sky", "b"): (29.0, 30.5, 29.9)}
    room, sky = (np.subtract(values[d, "a"], values[d, "b"]) for d in ("room", "sky"))
    welch = stats.ttest_ind(room, -sky, equal_var=False).confidence_interval(0.95)
    assert compared(values).gain == pytest.approx((welch.low / 2, welch.high / 2))


@pytest.mark.parametrize(
    ("differences", "better", "worse", "as_good", "tied"),
    [
        ((0.5, 0.6, 0.7), True, False, True, False),
        ((-0.5, -0.6, -0.7), False, True, False, False),
        ((-0.04, -0.05, -0.06), False, True, True, False),  # worse, and by less than the tolerance
        ((0.5, -0.6, 0.7), False, False, False, True),
        ((0.0, 0.01, -0.01), False, False, True, True),
    ],
)
def test_the_rules(differences: tuple[float, ...], better: bool, worse: bool, as_good: bool, tied: bool) -> None:
    base = (20.0, 25.0, 30.0)
    values = {("room", "a"): tuple(b + d for b, d in zip(base, differences, strict=True)), ("room", "b"): base}
    found = compared(values)
    assert (found.better(), found.worse(), found.as_good(0.1), found.tied) == (better, worse, as_good, tied)
    mirrored = compared(values, sign=-1)
    assert (mirrored.better(), mirrored.worse()) == (worse, better)
    assert not found.better(by=0.9)
    assert not found.worse(by=0.9)


def test_too_few_seeds_in_common_give_no_verdict() -> None:
    few = compared({("room", "a"): (21.0, 21.0), ("room", "b"): (20.0, 20.0)})
    assert few.difference.done < FEWEST_SEEDS
    assert not any((few.better(), few.worse(), few.as_good(1.0), few.tied))
    none = compared({("room", "a"): (21.0,), ("room", "b"): (20.0,)})
    assert none.gain is None
    assert not any((none.better(), none.worse(), none.as_good(1.0), none.tied))


def test_two_seeds_on_each_of_several_data_sets_are_enough_for_their_mean() -> None:
    values = {(d, m): (20.0 + (m == "a"), 20.1 + (m == "a")) for d in ("x", "y", "z") for m in ("a", "b")}
    assert compared(values).better()
