import json
from typing import Any

import numpy as np
import pytest
from scipy import stats

from stepgap.learning.polynomial import DEGREES, PRIOR_COUNT, PRIOR_STD, Polynomial, fit_polynomial
from stepgap.step import Array

CENTRE = np.array([0.2, 0.58, 0.0])
SCALE = np.array([0.2, 0.045, 15.0])
NOISE_SCALE = 0.01


def data(size: int = 30, seed: int = 0) -> tuple[Array, Array]:
    generator = np.random.default_rng(seed)
    x = generator.uniform(-1, 1, (size, 3))
    values = 0.1 + x @ [0.05, -0.02, 0.01] + 0.03 * x[:, 0] * x[:, 2] + 0.005 * generator.standard_normal(size)
    return CENTRE + SCALE * x, values


def fitted(kind: str, size: int = 30) -> Polynomial:
    return fit_polynomial(kind, *data(size), CENTRE, SCALE, NOISE_SCALE)


@pytest.fixture(params=list(DEGREES))
def polynomial(request: pytest.FixtureRequest) -> Polynomial:
    return fitted(request.param)


def assert_alike(one: Polynomial, other: Polynomial) -> None:
    queries = data(7, seed=9)[0]
    for include_noise in (False, True):
        np.testing.assert_allclose(
            one.std(queries, include_noise=include_noise), other.std(queries, include_noise=include_noise), rtol=1e-9
        )
    np.testing.assert_allclose(one.mean(queries), other.mean(queries), rtol=0, atol=1e-9)


class TestAgainstTheDefinition:
    def test_posterior_is_prior_times_likelihood(self) -> None:
        """One weight and the noise integrated numerically, with nothing of the closed form."""
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
        polynomial = fit_polynomial("constant", np.tile(CENTRE, (2, 1)), values, CENTRE, SCALE, NOISE_SCALE)
        assert polynomial.mean(CENTRE) == pytest.approx(mean, rel=1e-6)
        assert polynomial.std(CENTRE) == pytest.approx(std, rel=1e-4)

    def test_many_values_give_least_squares_and_its_noise(self) -> None:
        points, values = data(400)
        x = (points - CENTRE) / SCALE
        basis = np.hstack([np.ones((400, 1)), x])
        weights, squares, *_ = np.linalg.lstsq(basis, values, rcond=None)
        polynomial = fitted("linear", 400)
        np.testing.assert_allclose(polynomial.mean(points), basis @ weights, atol=2e-5)
        np.testing.assert_allclose(polynomial.mean_gradient(CENTRE), weights[1:] / SCALE, rtol=1e-3)
        noise = np.sqrt(polynomial.std(CENTRE, include_noise=True) ** 2 - polynomial.std(CENTRE) ** 2)
        assert noise == pytest.approx(np.sqrt(squares[0] / 396), rel=0.01)

    def test_quadratic_finds_a_quadratic(self) -> None:
        points = data(40)[0]

        def truth(points: Array) -> Array:
            x = (points - CENTRE) / SCALE
            return 0.1 + x[:, 0] ** 2 - 0.5 * x[:, 0] * x[:, 1] + 0.2 * x[:, 2]

        polynomial = fit_polynomial("quadratic", points, truth(points), CENTRE, SCALE, NOISE_SCALE)
        queries = data(20, seed=3)[0]
        np.testing.assert_allclose(polynomial.mean(queries), truth(queries), atol=2e-3)

    def test_noise_and_weights_of_the_right_size_cover_what_comes(self) -> None:
        """95 of 100 new values lie within the interval of Student's t, whatever the number of values learnt from."""
        generator = np.random.default_rng(4)
        for size in (6, 40):
            inside = []
            for _ in range(400):
                x, query = generator.uniform(-1, 1, (size, 3)), generator.uniform(-1, 1, 3)
                weights, noise = generator.normal(size=3), generator.standard_normal(size + 1) * 0.02
                points = CENTRE + SCALE * x
                polynomial = fit_polynomial("linear", points, x @ weights + noise[1:], CENTRE, SCALE, NOISE_SCALE)
                freedom, point = size + PRIOR_COUNT, CENTRE + SCALE * query
                spread = polynomial.std(point, include_noise=True) * np.sqrt((freedom - 2) / freedom)
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
        for include_noise in (False, True):
            np.testing.assert_allclose(
                polynomial.std_gradient(points[:, 0], include_noise=include_noise) * SCALE,
                derivative(lambda point, noisy=include_noise: polynomial.std(point, include_noise=noisy)),
                rtol=1e-6,
                atol=1e-10,
            )

    def test_appending_is_fitting_anew(self, polynomial: Polynomial) -> None:
        points, values = data(30)
        grown = fit_polynomial(polynomial.kind, points[:10], values[:10], CENTRE, SCALE, NOISE_SCALE)
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
            anew = fit_polynomial(polynomial.kind, *others, CENTRE, SCALE, NOISE_SCALE)
            np.testing.assert_allclose(found.mean[block], anew.mean(points[block]), rtol=0, atol=1e-9)
            np.testing.assert_allclose(found.std[block], anew.std(points[block], include_noise=True), rtol=1e-8)

    def test_comes_back(self, polynomial: Polynomial) -> None:
        saved = json.loads(json.dumps(polynomial.to_dict(), allow_nan=False))
        loaded = Polynomial.from_dict(saved)
        assert loaded.to_dict() == saved
        np.testing.assert_array_equal(loaded.mean(data()[0]), polynomial.mean(data()[0]))

    def test_poor_data_do_no_harm(self, polynomial: Polynomial) -> None:
        """Nothing, one value, inputs that never vary, and inputs that vary together."""
        points, values = data(30)
        same, together = np.tile(CENTRE, (30, 1)), CENTRE + np.outer(np.linspace(-1, 1, 30), SCALE)
        for poor in (points[:0], points[:1], same, together):
            fit = fit_polynomial(polynomial.kind, poor, values[: len(poor)], CENTRE, SCALE, NOISE_SCALE)
            assert np.isfinite(fit.mean(points)).all()
            assert (fit.std(points, include_noise=True) > 0).all()
            assert np.isfinite(fit.left_out([slice(i, i + 1) for i in range(len(poor))]).mean).all()
            assert np.abs(fit.mean(points)).max() < 1

    def test_what_the_data_leave_open_stays_open(self) -> None:
        same = fit_polynomial("linear", np.tile(CENTRE, (30, 1)), np.full(30, 0.1), CENTRE, SCALE, NOISE_SCALE)
        assert same.mean(CENTRE) == pytest.approx(0.1, rel=1e-3)
        assert same.std(CENTRE + SCALE) > 20 * same.std(CENTRE)


class TestRefused:
    @pytest.mark.parametrize(
        ("change", "named"),
        [
            ({"points": [[1.0, 2.0]]}, "^points must be"),
            ({"points": [[1.0], [2.0, 3.0]]}, "^points must be"),
            ({"values": ["a"]}, "^values must be"),
            ({"values": [0.0, 1.0]}, "^values must be"),
            ({"centre": [0.0]}, "^centre must be"),
            ({"scale": [1.0, 1.0, 0.0]}, "^scale must be"),
            ({"noise_scale": 0.0}, "^noise_scale must be"),
            ({"noise_scale": float("nan")}, "^noise_scale must be"),
        ],
    )
    def test_a_wrong_entry_is_named(self, change: dict[str, Any], named: str) -> None:
        with pytest.raises(ValueError, match=named):
            Polynomial.from_dict({**fitted("linear", 5).to_dict(), **change})

    @pytest.mark.parametrize("key", ["points", "values", "centre", "scale", "noise_scale"])
    def test_a_missing_entry_is_named(self, key: str) -> None:
        saved = fitted("linear", 5).to_dict()
        del saved[key]
        with pytest.raises(ValueError, match=f"^{key} must be .*missing"):
            Polynomial.from_dict(saved)
