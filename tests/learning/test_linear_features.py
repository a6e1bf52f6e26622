"""Linear features: directions of known functions, the number that is kept, and few data."""

import numpy as np
import pytest
from sklearn.linear_model import BayesianRidge

from stepgap.learning.linear_features import LEAST_VALUES, fit_linear_features
from stepgap.learning.regression import TrainingData
from stepgap.step import Array

INPUTS, CENTRE, SCALE = 12, np.linspace(-1, 1, 12), np.geomspace(0.1, 10, 12)


def data_of(function: str, size: int = 100, seed: int = 0) -> tuple[TrainingData, Array]:
    """Data of a function of one direction of the scaled inputs, and that direction."""
    rng = np.random.default_rng(seed)
    scaled, direction = rng.uniform(-1, 1, (size, INPUTS)), rng.standard_normal(INPUTS)
    direction /= np.linalg.norm(direction)
    along = scaled @ direction
    values = 0.2 * {"linear": along, "sine": np.sin(2 * along), "even": along**2}[function]
    noisy = values + 0.002 * rng.standard_normal(size)
    return TrainingData(CENTRE + SCALE * scaled, noisy, CENTRE, SCALE, 1.0), direction


@pytest.mark.parametrize(("function", "size"), [("linear", 60), ("sine", 100), ("even", 250)])
def test_the_direction_of_a_ridge_function_is_found(function: str, size: int) -> None:
    """Along an even function a linear regression would find nothing."""
    data, direction = data_of(function, size)
    matrix = fit_linear_features(data).matrix * SCALE
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(len(matrix)), atol=1e-12)
    assert len(matrix) <= 3
    assert abs(matrix[0] @ direction) > 0.98


def test_of_a_linear_function_it_is_the_direction_of_ridge_regression() -> None:
    data, _ = data_of("linear")
    weights = BayesianRidge().fit(data.scaled(data.points), data.values).coef_
    first = fit_linear_features(data).matrix[0] * SCALE
    assert abs(first @ weights) / np.linalg.norm(weights) > 0.9999


def test_features_are_projections_of_scaled_inputs() -> None:
    data, _ = data_of("sine")
    found = fit_linear_features(data)
    wanted = data.scaled(data.points) @ (found.matrix * SCALE).T
    np.testing.assert_allclose(found.features(data.points), wanted, atol=1e-12)


def test_with_few_values_all_inputs_are_kept() -> None:
    data, _ = data_of("linear", LEAST_VALUES - 1)
    np.testing.assert_array_equal(fit_linear_features(data).matrix, np.diag(1 / SCALE))


def test_the_same_data_give_the_same_features() -> None:
    one, other = (fit_linear_features(data_of("sine")[0]).matrix for _ in range(2))
    np.testing.assert_array_equal(one, other)


def test_copies_of_an_input_share_a_feature() -> None:
    """Redundant measurements: what ten copies have in common is one feature, also of other data."""
    rng = np.random.default_rng(3)

    def measured(common: Array) -> Array:
        return common[:, None] + 0.01 * rng.standard_normal((len(common), 10))

    common, others = rng.uniform(-1, 1, 80), rng.uniform(-1, 1, 200)
    values = 0.3 * np.sin(2 * common) + 0.005 * rng.standard_normal(80)
    found = fit_linear_features(TrainingData(measured(common), values, np.zeros(10), np.ones(10), 1.0))
    assert len(found.matrix) <= 2
    assert abs(np.corrcoef(found.features(measured(others))[:, 0], others)[0, 1]) > 0.99
