import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from stepgap.learning.polynomial import CONSTANT, LINEAR, PRIOR_COUNT, PRIOR_STD, QUADRATIC, Polynomial
from stepgap.learning.polynomial import NOISE_SCALE as RELATIVE_NOISE_SCALE
from stepgap.learning.regression import TrainingData
from stepgap.step import Array

CENTRE = np.array([0.2, 0.58, 0.0])
SCALE = np.array([0.2, 0.045, 15.0])
VALUE_SCALE = 0.5
NOISE_SCALE = RELATIVE_NOISE_SCALE * VALUE_SCALE
MODELS = (CONSTANT, LINEAR, QUADRATIC)


def data(size: int = 30, seed: int = 0) -> tuple[Array, Array]:
    generator = np.random.default_rng(seed)
    x = generator.uniform(-1, 1, (size, 3))
    values = 0.1 + x @ [0.05, -0.02, 0.01] + 0.03 * x[:, 0] * x[:, 2] + 0.005 * generator.standard_normal(size)
    return CENTRE + SCALE * x, values


def fit(degree: int, points: Array, values: Array) -> Polynomial:
    return Polynomial(TrainingData(points, values, CENTRE, SCALE, VALUE_SCALE), degree)


def fitted(degree: int, size: int = 30) -> Polynomial:
    return fit(degree, *data(size))


@pytest.fixture(params=range(3), ids=[model.name for model in MODELS])
def polynomial(request: pytest.FixtureRequest) -> Polynomial:
    return fitted(request.param)


def assert_alike(one: Polynomial, other: Polynomial) -> None:
    queries = data(7, seed=9)[0]
    np.testing.assert_allclose(one.std(queries), other.std(queries), rtol=1e-9)
    np.testing.assert_allclose(one.predict(queries).std, other.predict(queries).std, rtol=1e-9)
    np.testing.assert_allclose(one.mean(queries), other.mean(queries), rtol=0, atol=1e-9)


class TestAgainstTheDefinition:
    def test_posterior_is_prior_times_likelihood(self) -> None:
        """One weight and the noise, integrated numerically instead of the closed form."""
        values = np.array([0.03, 0.05])
        log_noise = np.linspace(-8, 2, 1001)[:, None]
        noise, deviation = np.exp(log_noise), np.linspace(-12, 12, 1001)  # of the weight from 0.04, in noises
        weight = 0.04 + deviation * noise
        density = noise * np.exp(
            -PRIOR_COUNT * (log_noise + 0.5 * (NOISE_SCALE / noise) ** 2)
            + stats.norm.logpdf(weight, 0, PRIOR_STD * noise)
            + sum(stats.norm.logpdf(value, weight, noise) for value in values)
        )
        mean = np.sum(weight * density) / np.sum(density)
        std = np.sqrt(np.sum((weight - mean) ** 2 * density) / np.sum(density))
        polynomial = fit(0, np.tile(CENTRE, (2, 1)), values)
        assert polynomial.mean(CENTRE) == pytest.approx(mean, rel=1e-6)
        assert polynomial.std(CENTRE) == pytest.approx(std, rel=1e-4)

    def test_many_values_give_least_squares_and_its_noise(self) -> None:
        points, values = data(400)
        x = (points - CENTRE) / SCALE
        basis = np.hstack([np.ones((400, 1)), x])
        weights, squares, *_ = np.linalg.lstsq(basis, values, rcond=None)
        polynomial = fitted(1, 400)
        np.testing.assert_allclose(polynomial.mean(points), basis @ weights, atol=2e-5)
        np.testing.assert_allclose(polynomial.mean_gradient(CENTRE), weights[1:] / SCALE, rtol=1e-3)
        noise = np.sqrt(polynomial.predict(CENTRE).std ** 2 - polynomial.std(CENTRE) ** 2)
        assert noise == pytest.approx(np.sqrt(squares[0] / 396), rel=0.01)

    def test_quadratic_finds_a_quadratic(self) -> None:
        points = data(40)[0]

        def truth(points: Array) -> Array:
            x = (points - CENTRE) / SCALE
            return 0.1 + x[:, 0] ** 2 - 0.5 * x[:, 0] * x[:, 1] + 0.2 * x[:, 2]

        polynomial = fit(2, points, truth(points))
        queries = data(20, seed=3)[0]
        np.testing.assert_allclose(polynomial.mean(queries), truth(queries), atol=2e-3)

    def test_intervals_cover_new_values_if_the_prior_is_right(self) -> None:
        """95 of 100 new values lie within the interval of Student's t, for any number of training values."""
        generator = np.random.default_rng(4)
        for size in (6, 40):
            inside = []
            for _ in range(400):
                x, query = generator.uniform(-1, 1, (size, 3)), generator.uniform(-1, 1, 3)
                weights, noise = generator.normal(size=3), generator.standard_normal(size + 1) * 0.02
                points = CENTRE + SCALE * x
                polynomial = fit(1, points, x @ weights + noise[1:])
                freedom, point = size + PRIOR_COUNT, CENTRE + SCALE * query
                spread = polynomial.predict(point).std * np.sqrt((freedom - 2) / freedom)
                error = query @ weights + noise[0] - polynomial.mean(point)
                inside.append(abs(error) < stats.t.ppf(0.975, freedom) * spread)
            assert 0.91 < np.mean(inside) < 0.985


class TestEveryDegree:
    def test_gradients_are_derivatives(self, polynomial: Polynomial) -> None:
        points = data(5, seed=2)[0][:, None]
        offset = np.diag(1e-5 * SCALE)

        def derivative(function: Any) -> Array:
            return (function(points + offset) - function(points - offset)) / 2e-5

        np.testing.assert_allclose(
            polynomial.mean_gradient(points[:, 0]) * SCALE, derivative(polynomial.mean), rtol=1e-6, atol=1e-10
        )
        np.testing.assert_allclose(
            polynomial.std_gradient(points[:, 0]) * SCALE, derivative(polynomial.std), rtol=1e-6, atol=1e-10
        )

    def test_appending_is_fitting_to_all_data(self, polynomial: Polynomial) -> None:
        points, values = data(30)
        grown = fit(polynomial.degree, points[:10], values[:10])
        for point, value in zip(points[10:], values[10:], strict=True):
            grown = grown.append(point, value)
        assert_alike(grown, polynomial)
        np.testing.assert_array_equal(grown.points, polynomial.points)

    @pytest.mark.parametrize("length", [1, 7, 30])
    def test_left_out_is_a_fit_to_the_others(self, polynomial: Polynomial, length: int) -> None:
        points, values = data(30)
        blocks = [slice(start, min(start + length, 30)) for start in range(0, 30, length)]
        found = polynomial.left_out(blocks)
        for block in blocks:
            others = np.delete(points, block, axis=0), np.delete(values, block)
            refitted = fit(polynomial.degree, *others)
            np.testing.assert_allclose(found.mean[block], refitted.mean(points[block]), rtol=0, atol=1e-9)
            np.testing.assert_allclose(found.std[block], refitted.predict(points[block]).std, rtol=1e-8)

    def test_is_restored(self, polynomial: Polynomial) -> None:
        saved = json.loads(json.dumps(polynomial.to_dict(), allow_nan=False))
        loaded = MODELS[polynomial.degree].from_dict(saved)
        assert loaded.to_dict() == saved
        np.testing.assert_array_equal(loaded.mean(data()[0]), polynomial.mean(data()[0]))

    def test_poor_data_do_no_harm(self, polynomial: Polynomial) -> None:
        """Nothing, one value, inputs that never vary, and inputs that vary together."""
        points, values = data(30)
        same, together = np.tile(CENTRE, (30, 1)), CENTRE + np.outer(np.linspace(-1, 1, 30), SCALE)
        for poor in (points[:0], points[:1], same, together):
            poor_fit = fit(polynomial.degree, poor, values[: len(poor)])
            assert np.isfinite(poor_fit.mean(points)).all()
            assert (poor_fit.predict(points).std > 0).all()
            assert np.isfinite(poor_fit.left_out([slice(i, i + 1) for i in range(len(poor))]).mean).all()
            assert np.abs(poor_fit.mean(points)).max() < 1

    def test_weights_that_the_data_do_not_determine_remain_uncertain(self) -> None:
        same = fit(1, np.tile(CENTRE, (30, 1)), np.full(30, 0.1))
        assert same.mean(CENTRE) == pytest.approx(0.1, rel=1e-3)
        assert same.std(CENTRE + SCALE) > 20 * same.std(CENTRE)


class TestRefused:
    @pytest.mark.parametrize("name", ["points", "values", "centre", "scale"])
    def test_a_single_number_is_no_array(self, name: str) -> None:
        data = TrainingData(np.zeros((1, 3)), np.zeros(1), CENTRE, SCALE, VALUE_SCALE)
        with pytest.raises(ValueError, match=rf"^{name}\.shape = \(\), but it must be \("):
            replace(data, **{name: np.array(1.0)})

    @pytest.mark.parametrize(
        ("change", "named"),
        [
            ({"points": [[1.0, 2.0]]}, "^points.shape = .* must be"),
            ({"points": [[1.0], [2.0, 3.0]]}, "^points must be"),
            ({"values": ["a"]}, "^values must be"),
            ({"values": [0.0, 1.0]}, "^values.shape = .* must be"),
            ({"centre": [0.0]}, "^centre.shape = .* must be"),
            ({"scale": [1.0, 1.0, 0.0]}, "^scale = .* must be"),
            ({"value_scale": 0.0}, "^value_scale = .* must be"),
            ({"value_scale": float("nan")}, "^value_scale must be"),
        ],
    )
    def test_a_wrong_entry_is_named(self, change: dict[str, Any], named: str) -> None:
        with pytest.raises(ValueError, match=named):
            LINEAR.from_dict({**fitted(1, 5).to_dict(), **change})

    @pytest.mark.parametrize("key", ["points", "values", "centre", "scale", "value_scale"])
    def test_a_missing_entry_is_named(self, key: str) -> None:
        saved = fitted(1, 5).to_dict()
        del saved[key]
        with pytest.raises(ValueError, match=f"^{key} must be .*missing"):
            LINEAR.from_dict(saved)
