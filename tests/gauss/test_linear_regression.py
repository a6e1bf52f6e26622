"""Linear regression against NumPy's, and leaving values out in closed form against leaving them out."""

import numpy as np

from stepgap.gauss.linear_regression import fit_linear

RNG = np.random.default_rng(4)
BASIS, VALUES = RNG.normal(size=(30, 5)), RNG.normal(size=(30, 2))


def test_it_is_least_squares() -> None:
    found = fit_linear(BASIS, VALUES)
    wanted = np.linalg.lstsq(BASIS, VALUES, rcond=None)[0]
    np.testing.assert_allclose(found.weights, wanted, atol=1e-12)
    np.testing.assert_allclose(found.residual, VALUES - BASIS @ wanted, atol=1e-12)
    assert found.rank == 5


def test_leaving_a_value_out_is_fitting_to_the_others() -> None:
    found = fit_linear(BASIS, VALUES)
    for row in (0, 13, 29):
        others = np.delete(np.arange(30), row)
        weights = np.linalg.lstsq(BASIS[others], VALUES[others], rcond=None)[0]
        np.testing.assert_allclose(found.left_out[row], VALUES[row] - BASIS[row] @ weights, atol=1e-12)


def test_dependent_columns_change_nothing_but_the_weights() -> None:
    plain, doubled = fit_linear(BASIS, VALUES), fit_linear(np.hstack([BASIS, BASIS[:, :2], np.zeros((30, 1))]), VALUES)
    assert doubled.rank == plain.rank
    np.testing.assert_allclose(doubled.left_out, plain.left_out, atol=1e-12)
