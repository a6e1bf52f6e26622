import itertools
import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import openturns as ot
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.stats import norm
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from stepgap.learning.gaussian_process import GaussianProcess, HyperParameters, condition
from stepgap.learning.gaussian_process_fit import (
    COLD_START_SIZE,
    Evidence,
    fit_gaussian_process,
    fit_like_fitrgp,
    squared_differences,
)
from stepgap.step import Array

CENTRE = np.array([0.2, 0.58, 0.0, 0.0])
SCALE = np.array([0.2, 0.045, 15.0, 20.0])
FIXED = HyperParameters(np.array([1.8, 2.6, 3.1, 4.2]), signal_std=0.031, noise_std=0.006)


def truth(points: Array) -> Array:
    """A smooth error of a step map in speed, height and two forces."""
    z = (points - CENTRE) / SCALE
    bend = 0.02 * np.tanh(z[..., 1] * z[..., 3]) + 0.01 * z[..., 2] ** 2
    return 0.04 + 0.03 * np.sin(1.3 * z[..., 0] + 0.5 * z[..., 2]) + bend


def sample(size: int, noise: float = 0.008, seed: int = 0) -> tuple[Array, Array]:
    generator = np.random.default_rng(seed)
    points = CENTRE + SCALE * generator.uniform(-1, 1, (size, 4))
    return points, truth(points) + noise * generator.standard_normal(size)


def central_difference(function: Callable[[Array], Any], at: Array, step: Array) -> Array:
    return np.stack([(function(at + h) - function(at - h)) / (2 * h.sum()) for h in np.diag(step)], axis=-1)


class TestAtFixedHyperParameters:
    def test_agrees_with_openturns(self) -> None:
        points, values = sample(60)
        queries, _ = sample(25, seed=1)
        process = condition(points, values, SCALE, FIXED)

        kernel = ot.MaternModel(FIXED.length_scale, [FIXED.signal_std], 2.5)
        kernel.setNuggetFactor((FIXED.noise_std / FIXED.signal_std) ** 2)
        fitter = ot.GaussianProcessFitter(points / SCALE, values[:, None], kernel, ot.ConstantBasisFactory(4).build())
        fitter.setOptimizeParameters(False)
        fitter.run()
        regression = ot.GaussianProcessRegression(fitter.getResult())
        regression.run()
        kriging = regression.getResult()
        covariance = ot.GaussianProcessConditionalCovariance(kriging)
        variance = np.ravel(covariance.getConditionalMarginalVariance(queries / SCALE))  # of a new noisy value

        assert process.log_likelihood == pytest.approx(fitter.getResult().getOptimalLogLikelihood(), rel=1e-10)
        assert process.coefficient == pytest.approx(kriging.getTrendCoefficients()[0], rel=1e-10)
        np.testing.assert_allclose(process.mean(queries), np.ravel(kriging.getMetaModel()(queries / SCALE)), rtol=1e-9)
        np.testing.assert_allclose(process.kriging_std(queries, include_noise=True) ** 2, variance, rtol=1e-9)
        np.testing.assert_allclose(process.kriging_std(queries) ** 2, variance - FIXED.noise_std**2, rtol=1e-8)

    def test_agrees_with_scikit_learn_once_the_basis_is_known(self) -> None:
        points, values = sample(60)
        queries, _ = sample(25, seed=1)
        process = condition(points, values, SCALE, FIXED)

        reach = SCALE * FIXED.length_scale
        kernel = ConstantKernel(FIXED.signal_std**2) * Matern(nu=2.5)
        centred = GaussianProcessRegressor(kernel, alpha=FIXED.noise_std**2, optimizer=None)  # pyright: ignore[reportArgumentType]
        centred.fit(points / reach, values - process.coefficient)
        mean, std = centred.predict(queries / reach, return_std=True)

        assert process.log_likelihood == pytest.approx(centred.log_marginal_likelihood(), rel=1e-10)
        np.testing.assert_allclose(process.mean(queries), process.coefficient + mean, rtol=1e-9)
        np.testing.assert_allclose(process.std(queries), std, rtol=1e-8)
        np.testing.assert_allclose(process.std(queries, include_noise=True), np.hypot(std, FIXED.noise_std), rtol=1e-9)

    def test_mean_gradient_is_the_derivative_of_the_mean(self) -> None:
        process = condition(*sample(60), SCALE, FIXED)
        queries, _ = sample(6, seed=2)
        for query in [*queries, process.points[0]]:
            expected = central_difference(process.mean, query, 1e-5 * SCALE)
            np.testing.assert_allclose(process.mean_gradient(query) * SCALE, expected * SCALE, rtol=1e-7, atol=1e-10)

    def test_far_from_the_data_only_the_basis_is_left(self) -> None:
        points, values = sample(60)
        process = condition(points, values, SCALE, FIXED)
        far = CENTRE + 1e4 * SCALE
        covariance = (
            FIXED.signal_std**2 * np.linalg.inv(process.least_squares.factor @ process.least_squares.factor.T).sum()
        )
        assert process.mean(far) == pytest.approx(process.coefficient)
        np.testing.assert_array_equal(process.mean_gradient(far), 0)
        assert process.std(far) == pytest.approx(FIXED.signal_std)
        assert process.kriging_std(far) == pytest.approx(
            math.sqrt(FIXED.signal_std**2 + FIXED.signal_std**4 / covariance)
        )

    def test_leading_axes_of_queries_are_kept(self) -> None:
        process = condition(*sample(60), SCALE, FIXED)
        queries, _ = sample(3000, seed=3)  # several blocks
        for method, tail in (
            (process.mean, ()),
            (process.mean_gradient, (4,)),
            (process.std, ()),
            (process.kriging_std, ()),
        ):
            batch = method(queries.reshape(3, 1000, 4))
            assert batch.shape == (3, 1000, *tail)
            np.testing.assert_allclose(batch[2, 999], method(queries[-1]), rtol=1e-10, atol=1e-14)
            assert method(queries[:0]).shape == (0, *tail)

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    def test_a_query_that_is_not_finite_gives_nan(self, bad: float) -> None:
        process = condition(*sample(20), SCALE, FIXED)
        queries = np.stack([CENTRE, np.append(CENTRE[:3], bad)])
        for method in (process.mean, process.mean_gradient, process.std, process.kriging_std):
            good_result, bad_result = method(queries)
            assert np.all(np.isfinite(good_result))
            assert np.all(np.isnan(bad_result))

    def test_without_noise_it_interpolates(self) -> None:
        points, values = sample(30, noise=0)
        process = condition(points, values, SCALE, HyperParameters(FIXED.length_scale, FIXED.signal_std, 0.0))
        np.testing.assert_allclose(process.mean(points), values, atol=1e-10)
        np.testing.assert_allclose(process.kriging_std(points), 0, atol=1e-7)

    def test_keeps_its_own_copy_of_the_data(self) -> None:
        points, values = sample(20)
        process = condition(points, values, SCALE, FIXED)
        before = process.mean(CENTRE)
        points[:], values[:] = 0, 0
        np.testing.assert_array_equal(GaussianProcess.from_dict(process.to_dict()).mean(CENTRE), before)


class TestEvidence:
    POINTS, VALUES = sample(25)
    DIFFERENCES = squared_differences(POINTS / SCALE)

    @pytest.mark.parametrize("with_prior", [False, True])
    @pytest.mark.parametrize("least_noise", [1e-9, 0.05], ids=["free", "binding"])
    @pytest.mark.parametrize("isotropic", [False, True])
    def test_gradient_is_the_derivative_of_the_loss(
        self, isotropic: bool, least_noise: float, with_prior: bool
    ) -> None:
        differences = self.DIFFERENCES.sum(axis=0, keepdims=True) if isotropic else self.DIFFERENCES
        evidence = Evidence(differences, self.VALUES, least_noise, with_prior)
        generator = np.random.default_rng(4)
        for _ in range(5):
            log_parameters = np.log([*[2.0] * len(differences), 0.4]) + 0.7 * generator.standard_normal(
                len(differences) + 1
            )
            _, gradient = evidence.loss(log_parameters)
            expected = central_difference(lambda p: evidence.loss(p)[0], log_parameters, np.full(len(gradient), 1e-5))
            np.testing.assert_allclose(gradient, expected, rtol=1e-6, atol=1e-6)

    def test_loss_is_the_negative_log_posterior(self) -> None:
        evidence = Evidence(self.DIFFERENCES, self.VALUES, 1e-9, with_prior=True)

        def expected(log_parameters: Array) -> float:
            signal, noise = evidence.signal_and_noise(log_parameters)
            kernel = np.asarray(Matern(nu=2.5)(self.POINTS / (SCALE * np.exp(log_parameters[:-1]))), float)
            covariance = signal**2 * kernel + noise**2 * np.eye(len(self.VALUES))
            by_ones = np.linalg.solve(covariance, np.ones(len(self.VALUES)))
            error = self.VALUES - by_ones @ self.VALUES / by_ones.sum()
            likelihood = -0.5 * (error @ np.linalg.solve(covariance, error) + np.linalg.slogdet(covariance).logabsdet)
            length_scales, ratio = log_parameters[:-1], log_parameters[-1]
            return likelihood + norm.logpdf(length_scales, np.log(3)).sum() + norm.logpdf(ratio, np.log(0.5))

        here, there = np.log([1.0, 2.0, 3.0, 4.0, 0.3]), np.log([2.0, 1.5, 5.0, 0.8, 0.9])
        difference = evidence.loss(there)[0] - evidence.loss(here)[0]
        assert difference == pytest.approx(expected(here) - expected(there), rel=1e-9)

    def test_the_signal_and_the_basis_are_the_most_likely_ones(self) -> None:
        log_parameters = np.log([1.0, 2.0, 3.0, 4.0, 0.3])
        signal, noise = Evidence(self.DIFFERENCES, self.VALUES, 1e-9, with_prior=False).signal_and_noise(log_parameters)
        process = condition(
            self.POINTS, self.VALUES, SCALE, HyperParameters(np.exp(log_parameters[:-1]), signal, noise)
        )
        for factor in (0.99, 1.01):
            other = HyperParameters(np.exp(log_parameters[:-1]), factor * signal, factor * noise)
            assert condition(self.POINTS, self.VALUES, SCALE, other).log_likelihood < process.log_likelihood
        whitened = (
            np.linalg.solve(process.least_squares.factor, np.ones(25)),
            np.linalg.solve(process.least_squares.factor, self.VALUES),
        )
        assert process.coefficient == pytest.approx(np.linalg.lstsq(whitened[0][:, None], whitened[1])[0][0])


class TestFit:
    @pytest.mark.parametrize(("size", "largest_error"), [(50, 0.0085), (200, 0.004)])
    def test_recovers_a_smooth_truth(self, size: int, largest_error: float) -> None:
        process = fit_gaussian_process(*sample(size), SCALE)
        queries, observed = sample(2000, seed=5)
        error = process.mean(queries) - truth(queries)
        covered = np.abs(error) < norm.ppf(0.975) * process.kriging_std(queries)
        observations = np.abs(process.mean(queries) - observed) < norm.ppf(0.975) * process.kriging_std(
            queries, include_noise=True
        )
        assert np.sqrt(np.mean(error**2)) < largest_error
        assert 0.85 < covered.mean() < 0.995
        assert 0.90 < observations.mean() < 0.98
        assert process.hyper_parameters.noise_std == pytest.approx(0.008, rel=0.35)

    @pytest.mark.parametrize(("size", "decisive"), [(20, 0), (20, 1), (20, 2), (20, 3), (COLD_START_SIZE + 60, 1)])
    def test_no_other_search_ends_higher(self, size: int, decisive: int) -> None:
        points, noise = sample(size, seed=12)
        values = np.sin(9 * (points - CENTRE)[:, decisive] / SCALE[decisive]) + noise
        hyper_parameters = fit_gaussian_process(points, values, SCALE).hyper_parameters
        evidence = Evidence(squared_differences(points / SCALE), values, 1e-9, with_prior=True)
        ratio = hyper_parameters.noise_std / hyper_parameters.signal_std
        found, gradient = evidence.loss(np.log([*hyper_parameters.length_scale, ratio]))
        assert np.abs(gradient).max() < 0.05
        generator = np.random.default_rng(7)
        for start in np.log([2.0, 2.0, 2.0, 2.0, 0.2]) + generator.standard_normal((5, 5)):
            other = minimize(evidence.loss, start, jac=True, method="L-BFGS-B", bounds=[(-4, 4)] * 5)
            assert found < other.fun + 1e-3

    def test_priors_keep_a_small_fit_from_taking_noise_for_signal(self) -> None:
        for seed in range(5):
            generator = np.random.default_rng(seed)
            points = CENTRE + SCALE * generator.uniform(-1, 1, (20, 4))
            hyper_parameters = fit_gaussian_process(points, generator.standard_normal(20), SCALE).hyper_parameters
            assert hyper_parameters.noise_std > 0.05 * hyper_parameters.signal_std

    def test_units_of_inputs_and_outputs_do_not_matter(self) -> None:
        points, values = sample(40)
        units = np.array([3.6, 1000.0, 0.001, 0.2])
        process = fit_gaussian_process(points, values, SCALE)
        other = fit_gaussian_process(points * units, 1000 * values - 7, SCALE * units)
        queries, _ = sample(10, seed=8)
        np.testing.assert_allclose(other.mean(queries * units), 1000 * process.mean(queries) - 7, rtol=1e-4, atol=1e-2)
        np.testing.assert_allclose(other.kriging_std(queries * units), 1000 * process.kriging_std(queries), rtol=1e-3)

    def test_is_deterministic(self) -> None:
        first, second = (fit_gaussian_process(*sample(40), SCALE).to_dict() for _ in range(2))
        assert first == second

    def test_fitrgp_is_a_maximum_of_the_likelihood_in_raw_units(self) -> None:
        points, values = sample(60, seed=9)
        points = points / SCALE
        process = fit_like_fitrgp(points, values)
        found = process.hyper_parameters
        assert np.ptp(found.length_scale) == 0
        np.testing.assert_array_equal(process.input_scale, 1)
        for length, signal, noise in np.exp(0.1 * np.vstack([np.eye(3), -np.eye(3)])):
            moved = HyperParameters(length * found.length_scale, signal * found.signal_std, noise * found.noise_std)
            assert condition(points, values, np.ones(4), moved).log_likelihood < process.log_likelihood

    def test_fitrgp_keeps_its_lower_bound_of_the_noise(self) -> None:
        points, values = sample(60, noise=0)
        found = fit_like_fitrgp(points / SCALE, values).hyper_parameters
        assert found.noise_std == pytest.approx(0.01 * values.std(ddof=1))


COORDINATE = st.sampled_from([0.0, 1.0, 1.0 + 1e-12, 1.0 + 1e-9, 1.5, -3.0])
VALUE = st.sampled_from([0.0, 0.1, 0.1 + 1e-15, -2.0, 1e-9, 1e6])


@st.composite
def awkward_data(draw: st.DrawFn) -> tuple[Array, Array]:
    """Few, duplicated, nearly duplicated or constant points with values of any size."""
    size, inputs = draw(st.integers(1, 7)), draw(st.integers(1, 3))
    points = draw(st.lists(st.lists(COORDINATE, min_size=inputs, max_size=inputs), min_size=size, max_size=size))
    return np.array(points), np.array(draw(st.lists(VALUE, min_size=size, max_size=size)))


@settings(max_examples=80, deadline=None, derandomize=True, database=None)
@given(awkward_data())
def test_awkward_data_never_fail(data: tuple[Array, Array]) -> None:
    points, values = data
    scale = np.ones(points.shape[1])
    processes = [
        fit_gaussian_process(points, values, scale),
        fit_like_fitrgp(points, values),
        condition(points, values, scale, HyperParameters(3 * scale, 1.0, 0.0)),
    ]
    queries = np.concatenate([points, np.full((1, points.shape[1]), 0.3)])
    reach = np.abs(values).max()
    for process in processes:
        assert math.isfinite(process.log_likelihood)
        assert np.all(np.isfinite(process.mean_gradient(queries)))
        assert np.all(process.std(queries) >= 0)
        assert np.all(process.std(queries) <= process.kriging_std(queries))
        assert np.all(np.isfinite(process.kriging_std(queries, include_noise=True)))
    for process in processes[:2]:
        assert np.all(process.kriging_std(queries, include_noise=True) > 0)
        assert np.all(np.abs(process.mean(queries)) <= 3 * reach)


@pytest.mark.parametrize("fit", [lambda p, v: fit_gaussian_process(p, v, SCALE), fit_like_fitrgp], ids=["gp", "fitrgp"])
def test_constant_values_are_predicted_everywhere(fit: Callable[[Array, Array], GaussianProcess]) -> None:
    points, _ = sample(40)
    process = fit(points, np.full(40, 0.03))
    queries, _ = sample(20, seed=10)
    np.testing.assert_allclose(process.mean(queries), 0.03, rtol=1e-9)
    np.testing.assert_allclose(process.mean_gradient(queries), 0, atol=1e-9)
    assert np.all(process.kriging_std(queries) < 1e-5)


class TestSaved:
    def test_comes_back_bit_for_bit(self) -> None:
        process = fit_gaussian_process(*sample(60), SCALE)
        loaded = GaussianProcess.from_dict(json.loads(json.dumps(process.to_dict(), allow_nan=False)))
        queries, _ = sample(50, seed=11)
        assert loaded.to_dict() == process.to_dict()
        assert loaded.log_likelihood == process.log_likelihood
        for method in ("mean", "mean_gradient", "std", "kriging_std"):
            np.testing.assert_array_equal(getattr(loaded, method)(queries), getattr(process, method)(queries))

    @pytest.mark.parametrize(
        ("key", "wrong"),
        [
            *itertools.product(
                ["input_scale", "points", "values", "length_scale", "signal_std", "noise_std"],
                [None, "0.1", True, [], [[1.0], [1.0, 2.0]], {"1": 1.0}],
            ),
            *itertools.product(["input_scale", "length_scale"], [[1.0, 1.0, 1.0, np.nan], [1.0, 1.0, 1.0, 0.0]]),
            *itertools.product(["signal_std", "noise_std"], [-1.0, np.nan, np.inf]),
            ("signal_std", 0.0),
            ("length_scale", [1.0, 1.0, 1.0]),
            ("values", [1.0, 1.0]),
            ("values", [1.0, 1.0, np.nan]),
            ("points", [[1.0, 1.0, 1.0]] * 3),
            ("points", [[1.0, 1.0, 1.0, np.inf]] * 3),
        ],
    )
    def test_a_wrong_entry_is_named(self, key: str, wrong: Any) -> None:
        saved = condition(*sample(3), SCALE, FIXED).to_dict()
        with pytest.raises(ValueError, match=f"^{key} must be"):
            GaussianProcess.from_dict({**saved, key: wrong})

    def test_a_missing_entry_is_named(self) -> None:
        saved = condition(*sample(3), SCALE, FIXED).to_dict()
        for key in saved:
            with pytest.raises(ValueError, match=f"^{key} must be .* missing"):
                GaussianProcess.from_dict({name: entry for name, entry in saved.items() if name != key})


@pytest.mark.parametrize(
    ("points", "values", "scale", "named"),
    [
        (np.zeros((3, 4)), np.zeros(2), SCALE, "values"),
        (np.zeros((3, 3)), np.zeros(3), SCALE, "points"),
        (np.zeros(4), np.zeros(1), SCALE, "points"),
        (np.zeros((0, 4)), np.zeros(0), SCALE, "points"),
        (np.full((3, 4), np.nan), np.zeros(3), SCALE, "points"),
        (np.zeros((3, 4)), np.full(3, np.inf), SCALE, "values"),
        (np.zeros((3, 4)), np.zeros(3), 0 * SCALE, "input_scale"),
    ],
)
def test_unsound_data_are_refused(points: Array, values: Array, scale: Array, named: str) -> None:
    with pytest.raises(ValueError, match=f"^{named} must be"):
        fit_gaussian_process(points, values, scale)
