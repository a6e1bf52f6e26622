"""Paired differences over twins and seeds, against other implementations and simulated experiments."""

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from benchmarks.learning.paired_differences import LARGEST_RATIO, holm, log_ratio, paired_difference


def test_the_difference_is_that_of_a_t_test_on_the_means_of_twins() -> None:
    rng = np.random.default_rng(0)
    differences = rng.normal(0.2, 0.3, (8, 3))
    keys = [(twin, seed) for twin in range(8) for seed in range(3)]
    others = {key: float(rng.uniform(0.1, 2)) for key in keys}
    errors = {key: others[key] * float(np.exp(differences[key])) for key in keys}
    found, expected = paired_difference(errors, others), ttest_1samp(differences.mean(axis=1), 0)
    _, p_value = expected
    assert found.ratio == pytest.approx(np.exp(differences.mean()))
    assert found.p_value == pytest.approx(p_value)
    assert (found.low, found.high) == pytest.approx(tuple(np.exp(expected.confidence_interval(0.95))))


def test_seeds_of_one_twin_are_not_independent() -> None:
    """Twins differ, seeds hardly: with all cases as independent the interval would be far too narrow."""
    rng, count, covered = np.random.default_rng(1), 400, 0
    for _ in range(count):
        differences = rng.normal(0, 0.3, (10, 1)) + rng.normal(0, 0.05, (10, 3))
        errors = {(twin, seed): float(np.exp(differences[twin, seed])) for twin in range(10) for seed in range(3)}
        found = paired_difference(errors, dict.fromkeys(errors, 1.0))
        covered += found.low <= 1 <= found.high
    assert 0.92 < covered / count < 0.98


def test_failed_steps_count_as_the_largest_ratio() -> None:
    assert log_ratio(np.inf, 0.1) == pytest.approx(np.log(LARGEST_RATIO)) == -log_ratio(0.1, np.inf)
    assert log_ratio(np.inf, np.inf) == 0
    assert log_ratio(0.2, 0.1) == pytest.approx(np.log(2))


def test_equal_errors_differ_by_nothing_and_one_twin_has_no_interval() -> None:
    errors = {(0, 0): 0.1, (1, 0): 0.3}
    found = paired_difference(errors, errors)
    assert (found.ratio, found.low, found.high, found.p_value) == (1, 1, 1, 1)
    single = paired_difference({(0, 0): 0.2, (0, 1): 0.2}, {(0, 0): 0.1, (0, 1): 0.1})
    assert single.ratio == pytest.approx(2)
    assert np.isnan([single.low, single.high, single.p_value]).all()


def test_p_values_are_adjusted_as_in_the_textbook_example() -> None:
    # 0.005 × 4, 0.01 × 3, 0.03 × 2; then 0.04 is below its predecessor
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1, 1]
    np.testing.assert_array_equal(holm([np.nan, 0.04]), [np.nan, 0.04])
    assert holm([]) == []
