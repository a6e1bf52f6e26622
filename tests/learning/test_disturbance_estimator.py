"""The disturbance is that of the filter over all steps but outliers, and zero where it is not estimated."""

from math import nan

import numpy as np
import pytest

from stepgap.learning.disturbance import DisturbanceFilter
from stepgap.learning.disturbance_estimator import DisturbanceEstimator
from stepgap.learning.observations import observe
from stepgap.learning.outliers import LEAST_KNOWN
from stepgap.learning.residual import Residual, no_residual
from stepgap.learning.residual_fit import fit_residual
from stepgap.step import Array
from tests.learning.test_outliers import NOISE, NOMINAL, SCALE, hops, log_of

YAWS = np.append(nan, 0.3 * np.arange(39))
ERRORS = np.random.default_rng(4).normal([0.01, 0.0], 0.5 * NOISE, (40, 2))


def fitted(steps: int = 60) -> Residual:
    return fit_residual("linear", observe(log_of(hops(steps, 1, {})), NOMINAL))


def after(residual: Residual, errors: Array, *, drift: bool = True, reject_outliers: bool = True):
    """The estimate after steps with these errors, and the numbers of the outliers among them."""
    found = DisturbanceEstimator.start(SCALE, drift=drift, reject_outliers=reject_outliers)
    outliers = []
    for number, (error, yaw) in enumerate(zip(errors, YAWS, strict=True)):
        found = found.after(residual, error, residual.noise_std, yaw)
        outliers += [number] if found.outlier else []
    return found, outliers


def filter_over(errors: Array, omitted: list[int]) -> DisturbanceFilter:
    found = DisturbanceFilter.initial(2)
    for number, (error, yaw) in enumerate(zip(errors, YAWS, strict=True)):
        found = found if number in omitted else found.updated(error, yaw)
    return found


@pytest.mark.parametrize(
    ("pushed", "outliers"), [([], []), ([12], [12]), ([12, 13, 14], [12]), ([12, 14], [12, 14])], ids=str
)
def test_only_the_first_of_several_improbable_steps_is_an_outlier(pushed: list[int], outliers: list[int]) -> None:
    residual, errors = fitted(), ERRORS.copy()
    errors[pushed, 0] += 0.5
    found, left_out = after(residual, errors)
    assert left_out == outliers
    expected = filter_over(errors, outliers)
    offset, std = found.predict(residual, 1.0)
    np.testing.assert_array_equal(offset, expected.offset(1.0))
    np.testing.assert_array_equal(std, expected.std(1.0) * residual.noise_std)
    np.testing.assert_array_equal(found.filter.coefficients, expected.coefficients)


def test_outliers_are_used_if_that_is_wanted_or_too_little_is_known() -> None:
    errors = ERRORS.copy()
    errors[12, 0] += 0.5
    expected = filter_over(errors, []).offset(1.0)
    for residual, reject in ((fitted(), False), (fitted(LEAST_KNOWN - 1), True)):
        found, outliers = after(residual, errors, reject_outliers=reject)
        assert outliers == []
        np.testing.assert_array_equal(found.predict(residual, 1.0)[0], expected)


def test_where_it_is_not_estimated_it_is_zero() -> None:
    errors = ERRORS.copy()
    errors[12, 0] += 0.5
    for residual, drift, outliers in ((fitted(), False, [12]), (no_residual(2, 2), True, [])):
        found, left_out = after(residual, errors, drift=drift)
        assert left_out == outliers, "an outlier is one with or without an estimate of the disturbance"
        np.testing.assert_array_equal(found.predict(residual, 1.0), np.zeros((2, 2)))
