"""Statistics of levels, compared with those of SciPy and NumPy."""

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from stepgap.sweep.report.levels import (
    geometric_means,
    level_means,
    matched_groups,
    overall_mean,
    paired_ratios,
    quartiles,
    shares,
)
from tests.sweep.report.tables import cases_of, combinations_of


def test_geometric_means_have_students_interval() -> None:
    rng = np.random.default_rng(0)
    errors, codes = rng.lognormal(size=40), rng.integers(0, 3, 40)
    errors[::7] = np.nan
    found = geometric_means(errors, codes, 5)
    for level in range(3):
        known = errors[(codes == level) & np.isfinite(errors)]
        interval = stats.ttest_1samp(np.log(known), 0).confidence_interval(0.95)
        assert found.counts[level] == len(known)
        assert found.values[level] == pytest.approx(stats.gmean(known))
        assert (found.lower[level], found.upper[level]) == pytest.approx((np.exp(interval.low), np.exp(interval.high)))
    np.testing.assert_array_equal(found.counts[3:], 0)
    assert np.isnan(found.values[3:]).all()


def test_one_case_has_no_interval() -> None:
    found = geometric_means(np.array([2.0]), np.array([0]), 1)
    assert found.values[0] == pytest.approx(2)
    assert np.isnan([found.lower[0], found.upper[0]]).all()
    assert np.isnan(overall_mean(np.array([np.nan])))


@pytest.mark.parametrize(("chosen", "count"), [(0, 5), (3, 5), (5, 5), (1, 200), (1, 1)])
def test_shares_have_wilsons_interval(chosen: int, count: int) -> None:
    found = shares(np.arange(count) < chosen, np.zeros(count, int), 2)
    interval = stats.binomtest(chosen, count).proportion_ci(method="wilson")
    assert found.values[0] == chosen / count
    assert (found.lower[0], found.upper[0]) == pytest.approx((interval.low, interval.high), abs=1e-4)
    assert np.isnan(found.values[1])


def test_quartiles_count_never_as_infinite() -> None:
    rng = np.random.default_rng(0)
    values, codes = rng.integers(20, 200, 60).astype(float), rng.integers(0, 3, 60)
    values[rng.random(60) < 0.4] = np.inf
    found = quartiles(values, codes, 4)
    for level in range(3):
        wanted = np.quantile(values[codes == level], [0.25, 0.5, 0.75], method="inverted_cdf")
        np.testing.assert_array_equal(found[:, level], wanted)
    assert np.isnan(found[:, 3]).all()


def test_ratios_of_pairs_are_exact_whatever_else_differs(tmp_path: Path) -> None:
    settings = combinations_of({"a": ["x", "y", "z"], "twin": range(5), "gap.drag": [0.1, 0.2], "seed": [1, 2]})
    rng = np.random.default_rng(0)
    logs = np.log([1, 0.8, 2.5])[:, np.newaxis] + 3 * rng.normal(size=20)
    cases = cases_of(tmp_path, settings, logs.ravel())
    axis = cases.axes[0]
    found = paired_ratios(matched_groups(cases, axis), axis, cases.last_errors[:, 0])
    np.testing.assert_allclose(found.values, [1, 0.8, 2.5])
    np.testing.assert_allclose(found.lower, [1, 0.8, 2.5])
    np.testing.assert_array_equal(found.counts, 20)


def test_ratios_have_the_interval_of_the_paired_t_test(tmp_path: Path) -> None:
    settings = combinations_of({"twin": range(12), "a": [1, 2], "seed": [1]})
    logs = np.random.default_rng(0).normal(size=(12, 2))
    cases = cases_of(tmp_path, settings, logs.ravel())
    axis = cases.axes[1]
    errors = cases.last_errors[:, 0].copy()
    errors[[0, 3]] = np.nan  # one of the first pair, the other of the second
    found = paired_ratios(matched_groups(cases, axis), axis, errors)
    interval = stats.ttest_rel(logs[2:, 1], logs[2:, 0]).confidence_interval(0.95)
    assert found.counts[1] == 10
    assert (found.lower[1], found.upper[1]) == pytest.approx((np.exp(interval.low), np.exp(interval.high)))


def test_settings_that_move_together_have_no_pairs(tmp_path: Path) -> None:
    settings = {"a": ["1", "2"] * 4, "b": ["3", "4"] * 4, "seed": list(map(str, np.repeat(range(4), 2)))}
    cases = cases_of(tmp_path, settings, np.zeros(8))
    axis = cases.axes[0]
    assert paired_ratios(matched_groups(cases, axis), axis, cases.last_errors[:, 0]).counts[1] == 0


def test_points_count_once_in_the_interval_of_a_range(tmp_path: Path) -> None:
    """Cases that are repeated do not make the interval of a Sobol' sequence narrower."""
    rng = np.random.default_rng(0)
    values, logs = rng.random(50), rng.normal(size=50)
    once = cases_of(tmp_path / "once", {"a": values.astype(str).tolist(), "seed": ["0"] * 50}, logs)
    often = {"a": np.repeat(values, 8).astype(str).tolist(), "seed": list("01234567") * 50}
    repeated = cases_of(tmp_path / "repeated", often, np.repeat(logs, 8))
    wanted, found = (level_means(cases.axes[0], cases.last_errors[:, 0]) for cases in (once, repeated))
    np.testing.assert_allclose(found.values, wanted.values)
    np.testing.assert_allclose(found.upper, wanted.upper)
