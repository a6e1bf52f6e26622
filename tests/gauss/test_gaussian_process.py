import itertools
import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.stats import multivariate_normal, norm
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct, Matern

from stepgap.gauss.evidence import Evidence, LogParameters
from stepgap.gauss.gaussian_process import (
    ExactGaussianProcess,
    GaussianProcess,
    HyperParameters,
    condition,
    process_from_dict,
)
from stepgap.gauss.gaussian_process_fit import (
    COLD_START_SIZE,
    Basis,
    fit_gaussian_process,
    fit_like_fitrgp,
)
from stepgap.gauss.kernel import MATERN_52, SQUARED_EXPONENTIAL, Kernel
from stepgap.step import Array

CENTRE = np.array([0.2, 0.58, 0.0, 0.0])
SCALE = np.array([0.2, 0.045, 15.0, 20.0])
FIXED = HyperParameters(np.array([1.8, 2.6, 3.1, 4.2]), signal_std=0.031, noise_std=0.006)
BASES: tuple[Basis, ...] = ("constant", "linear")
SLOPED = replace(FIXED, slope_std=0.02)


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


def log_likelihood(process: GaussianProcess) -> float:
    """Logarithm of p(values) at the hyper-parameters and β of an exact process."""
    assert isinstance(process, ExactGaussianProcess)
    return process.least_squares.log_likelihood(process.hyper_parameters.signal_std)


class TestAtFixedHyperParameters:
    def test_agrees_with_openturns(self) -> None:
        import openturns as ot  # takes long, and few of the processes that share the tests need it

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

        assert log_likelihood(process) == pytest.approx(fitter.getResult().getOptimalLogLikelihood(), rel=1e-10)
        assert process.coefficient == pytest.approx(kriging.getTrendCoefficients()[0], rel=1e-10)
        np.testing.assert_allclose(process.mean(queries), np.ravel(kriging.getMetaModel()(queries / SCALE)), rtol=1e-9)
        np.testing.assert_allclose(process.kriging_std(queries, include_noise=True) ** 2, variance, rtol=1e-9)
        np.testing.assert_allclose(process.kriging_std(queries) ** 2, variance - FIXED.noise_std**2, rtol=1e-8)

    def test_agrees_with_scikit_learn_once_the_basis_is_known(self) -> None:
        points, values = sample(60)
        queries, _ = sample(25, seed=1)
        process = condition(points, values, SCALE, FIXED)

        length_scale = SCALE * FIXED.length_scale
        kernel = ConstantKernel(FIXED.signal_std**2) * Matern(nu=2.5)
        centred = GaussianProcessRegressor(kernel, alpha=FIXED.noise_std**2, optimizer=None)  # pyright: ignore[reportArgumentType]
        centred.fit(points / length_scale, values - process.coefficient)
        mean, std = centred.predict(queries / length_scale, return_std=True)

        assert log_likelihood(process) == pytest.approx(centred.log_marginal_likelihood(), rel=1e-10)
        np.testing.assert_allclose(process.mean(queries), process.coefficient + mean, rtol=1e-9)
        np.testing.assert_allclose(process.std(queries), std, rtol=1e-8)
        np.testing.assert_allclose(process.std(queries, include_noise=True), np.hypot(std, FIXED.noise_std), rtol=1e-9)

    @pytest.mark.parametrize(
        ("kernel", "theirs"),
        [(MATERN_52, Matern(nu=2.5)), (SQUARED_EXPONENTIAL, RBF())],
        ids=lambda each: str(each)[:6],
    )
    def test_every_kernel_agrees_with_scikit_learn(self, kernel: Kernel, theirs: Any) -> None:
        points, values = sample(60)
        queries, _ = sample(25, seed=1)
        process = condition(points, values, SCALE, FIXED, kernel)

        length_scale = SCALE * FIXED.length_scale
        centred = GaussianProcessRegressor(
            ConstantKernel(FIXED.signal_std**2) * theirs,
            alpha=FIXED.noise_std**2,  # pyright: ignore[reportArgumentType]
            optimizer=None,  # pyright: ignore[reportArgumentType]
        )
        centred.fit(points / length_scale, values - process.coefficient)
        mean, std = centred.predict(queries / length_scale, return_std=True)
        assert log_likelihood(process) == pytest.approx(centred.log_marginal_likelihood(), rel=1e-8)
        np.testing.assert_allclose(process.mean(queries), process.coefficient + mean, rtol=1e-8)
        np.testing.assert_allclose(process.std(queries), std, rtol=1e-8)

    @pytest.mark.parametrize("kernel", [MATERN_52, SQUARED_EXPONENTIAL], ids=lambda kernel: kernel.name)
    def test_a_kernel_and_its_radial_derivative_belong_together(self, kernel: Kernel) -> None:
        r = np.array([1e-3, 0.1, 0.7, 2.0, 5.0])
        derivative = (kernel.covariance((r + 1e-6) ** 2) - kernel.covariance((r - 1e-6) ** 2)) / 2e-6
        np.testing.assert_allclose(kernel.radial_derivative(r**2), derivative / r, rtol=1e-6)
        assert kernel.covariance(np.zeros(1)) == 1
        assert np.isfinite(kernel.radial_derivative(np.zeros(1))).all()

    def test_with_slopes_it_agrees_with_scikit_learn_once_the_constant_is_known(self) -> None:
        points, values = sample(60)
        queries, _ = sample(25, seed=1)
        process = condition(points, values, SCALE, SLOPED)

        slopes = ConstantKernel(SLOPED.slope_std**2) * DotProduct(sigma_0=0.0, sigma_0_bounds="fixed")
        bends = ConstantKernel(SLOPED.signal_std**2) * Matern(SLOPED.length_scale, nu=2.5)  # pyright: ignore[reportArgumentType]
        centred = GaussianProcessRegressor(slopes + bends, alpha=SLOPED.noise_std**2, optimizer=None)  # pyright: ignore[reportArgumentType]
        centred.fit((points - points[0]) / SCALE, values - process.coefficient)
        mean, std = centred.predict((queries - points[0]) / SCALE, return_std=True)

        assert log_likelihood(process) == pytest.approx(centred.log_marginal_likelihood(), rel=1e-10)
        np.testing.assert_allclose(process.mean(queries), process.coefficient + mean, rtol=1e-8)
        np.testing.assert_allclose(process.std(queries), std, rtol=1e-8)

    def test_with_wide_slopes_it_agrees_with_the_linear_basis_of_openturns(self) -> None:
        import openturns as ot  # takes long, and few of the processes that share the tests need it

        points, values = sample(60)
        queries, _ = sample(25, seed=1)
        process = condition(points, values, SCALE, replace(FIXED, slope_std=100.0))

        kernel = ot.MaternModel(FIXED.length_scale, [FIXED.signal_std], 2.5)
        kernel.setNuggetFactor((FIXED.noise_std / FIXED.signal_std) ** 2)
        fitter = ot.GaussianProcessFitter(points / SCALE, values[:, None], kernel, ot.LinearBasisFactory(4).build())
        fitter.setOptimizeParameters(False)
        fitter.run()
        regression = ot.GaussianProcessRegression(fitter.getResult())
        regression.run()
        kriging = regression.getResult()
        covariance = ot.GaussianProcessConditionalCovariance(kriging)
        variance = np.ravel(covariance.getConditionalMarginalVariance(queries / SCALE))
        np.testing.assert_allclose(process.mean(queries), np.ravel(kriging.getMetaModel()(queries / SCALE)), rtol=1e-5)
        np.testing.assert_allclose(process.kriging_std(queries, include_noise=True) ** 2, variance, rtol=1e-5)
        slope, trend = process.mean_gradient(CENTRE + 1e5 * SCALE) * SCALE, np.ravel(kriging.getTrendCoefficients())[1:]
        np.testing.assert_allclose(slope, trend, atol=1e-5 * np.abs(trend).max())  # rounding is that of all of them

    @pytest.mark.parametrize("hyper_parameters", [FIXED, SLOPED], ids=["constant", "linear"])
    @pytest.mark.parametrize("kernel", [MATERN_52, SQUARED_EXPONENTIAL], ids=lambda kernel: kernel.name)
    def test_gradients_are_derivatives(self, kernel: Kernel, hyper_parameters: HyperParameters) -> None:
        process = condition(*sample(60), SCALE, hyper_parameters, kernel)
        queries, _ = sample(6, seed=2)
        for query in [*queries, process.points[0], CENTRE + 5 * SCALE]:
            for function, gradient in (
                (process.mean, process.mean_gradient),
                (process.std, process.std_gradient),
                (process.kriging_std, process.kriging_std_gradient),
            ):
                expected = central_difference(function, query, 1e-5 * SCALE)
                np.testing.assert_allclose(gradient(query) * SCALE, expected * SCALE, rtol=1e-6, atol=1e-10)

    def test_far_from_the_data_only_the_basis_remains(self) -> None:
        points, values = sample(60)
        process = condition(points, values, SCALE, FIXED)
        far = CENTRE + 1e4 * SCALE
        factor = process.least_squares.factor
        covariance = FIXED.signal_std**2 * np.linalg.inv(factor @ factor.T).sum()
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
            (process.kriging_std_gradient, (4,)),
        ):
            batch = method(queries.reshape(3, 1000, 4))
            assert batch.shape == (3, 1000, *tail)
            np.testing.assert_allclose(batch[2, 999], method(queries[-1]), rtol=1e-10, atol=1e-14)
            assert method(queries[:0]).shape == (0, *tail)

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    def test_a_query_that_is_not_finite_gives_nan(self, bad: float) -> None:
        process = condition(*sample(20), SCALE, FIXED)
        queries = np.stack([CENTRE, np.append(CENTRE[:3], bad)])
        for method in (
            process.mean, process.mean_gradient, process.std, process.kriging_std, process.kriging_std_gradient
        ):  # fmt: skip
            good_result, bad_result = method(queries)
            assert np.all(np.isfinite(good_result))
            assert np.all(np.isnan(bad_result))

    def test_without_noise_it_interpolates(self) -> None:
        points, values = sample(30, noise=0)
        process = condition(points, values, SCALE, HyperParameters(FIXED.length_scale, FIXED.signal_std, 0.0))
        np.testing.assert_allclose(process.mean(points), values, atol=1e-10)
        np.testing.assert_allclose(process.kriging_std(points), 0, atol=1e-7)
        assert np.all(np.isfinite(process.kriging_std_gradient(points)))


def singles(count: int) -> list[slice]:
    """Blocks of one value each."""
    return [slice(row, row + 1) for row in range(count)]


class TestLeaveOneOut:
    @pytest.mark.parametrize("hyper_parameters", [FIXED, SLOPED, replace(FIXED, noise_std=0.0)])
    def test_is_the_prediction_of_the_process_without_the_point(self, hyper_parameters: HyperParameters) -> None:
        points, values = sample(30)
        mean, std, kriging_std = condition(points, values, SCALE, hyper_parameters).leave_out(singles(30))
        for i, (point, rest) in enumerate(zip(points, ~np.eye(30, dtype=bool), strict=True)):
            process = condition(points[rest], values[rest], SCALE, hyper_parameters)
            assert mean[i] == pytest.approx(process.mean(point), rel=1e-9)
            if i > 0 or hyper_parameters.slope_std == 0:  # slopes are zero at the first point, and std depends on where
                assert std[i] == pytest.approx(process.std(point, include_noise=True), rel=1e-9)
            assert kriging_std[i] == pytest.approx(process.kriging_std(point, include_noise=True), rel=1e-9)

    def test_a_single_point_has_no_prediction(self) -> None:
        mean, std, kriging_std = condition(*sample(1), SCALE, FIXED).leave_out(singles(1))
        assert np.isnan(mean)
        assert np.isposinf([std, kriging_std]).all()


class TestAppend:
    @pytest.mark.parametrize("hyper_parameters", [FIXED, SLOPED], ids=["constant", "linear"])
    @pytest.mark.parametrize("more", [1, 60])
    def test_is_the_same_as_conditioning_on_all(self, more: int, hyper_parameters: HyperParameters) -> None:
        points, values = sample(20 + more)
        process = condition(points[:20], values[:20], SCALE, hyper_parameters)
        for point, value in zip(points[20:], values[20:], strict=True):
            process = process.append(point, value)
        whole = condition(points, values, SCALE, hyper_parameters)
        assert process.to_dict() == whole.to_dict()
        assert log_likelihood(process) == pytest.approx(log_likelihood(whole), rel=1e-11)
        queries, _ = sample(10, seed=1)
        for method in ("mean", "mean_gradient", "std", "kriging_std", "kriging_std_gradient"):
            np.testing.assert_allclose(getattr(process, method)(queries), getattr(whole, method)(queries), rtol=1e-9)

    @pytest.mark.parametrize("offset", [0.0, 1e-14, 1e-9, 1e-5])
    @pytest.mark.parametrize("noise", [0.0, 1e-9, 1e-3])
    @pytest.mark.parametrize("slope", [0.0, 0.02])
    def test_nearly_equal_points_do_no_harm(self, offset: float, noise: float, slope: float) -> None:
        points, values = sample(20, noise=0)
        hyper_parameters = replace(FIXED, noise_std=noise, slope_std=slope)
        process = condition(points, values, SCALE, hyper_parameters)
        for i in range(4):
            process = process.append(points[i] + offset * SCALE, values[i])
        whole = condition(process.points, process.values, SCALE, hyper_parameters)
        queries, _ = sample(10, seed=1)
        np.testing.assert_allclose(process.mean(queries), whole.mean(queries), rtol=1e-3)
        assert np.all(np.isfinite(process.kriging_std(queries)))

    @pytest.mark.parametrize(
        ("point", "value", "named"),
        [(CENTRE[:3], 0.0, "points"), (np.append(CENTRE[:3], np.nan), 0.0, "points"), (CENTRE, np.inf, "values")],
    )
    def test_an_invalid_point_is_refused(self, point: Array, value: float, named: str) -> None:
        with pytest.raises(ValueError, match=rf"^{named}\b.* must be"):
            condition(*sample(3), SCALE, FIXED).append(point, value)


def logs(length_scale: list[float], *ratios: float) -> LogParameters:
    return LogParameters(np.log(length_scale), *np.log(ratios).tolist())


class TestEvidence:
    POINTS, VALUES = sample(25)
    HERE, THERE = logs([1.0, 2.0, 3.0, 4.0], 0.3, 0.6), logs([2.0, 1.5, 5.0, 0.8], 0.9, 2.0)

    def evidence(self, value_scale: float | None, least_noise: float = 1e-9, length_scales: int = 4) -> Evidence:
        return Evidence(self.POINTS / SCALE, self.VALUES, value_scale, length_scales, least_noise)

    @pytest.mark.parametrize("value_scale", [None, 0.2], ids=["likelihood", "prior"])
    @pytest.mark.parametrize("least_noise", [1e-9, 0.05], ids=["free", "binding"])
    @pytest.mark.parametrize("ratios", [(0.4,), (0.4, 0.6)], ids=["constant", "linear"])
    @pytest.mark.parametrize("kernel", [MATERN_52, SQUARED_EXPONENTIAL], ids=lambda kernel: kernel.name)
    def test_gradient_is_the_derivative_of_the_loss(
        self, kernel: Kernel, ratios: tuple[float, ...], least_noise: float, value_scale: float | None
    ) -> None:
        evidence = replace(self.evidence(value_scale, least_noise), kernel=kernel)
        self.check_gradient(evidence, logs([2.0] * 4, *ratios))

    def test_gradient_with_one_common_length_scale(self) -> None:
        self.check_gradient(self.evidence(None, length_scales=1), logs([2.0], 0.4))

    def check_gradient(self, evidence: Evidence, centre: LogParameters) -> None:
        generator, size = np.random.default_rng(4), len(centre.vector)
        for _ in range(5):
            vector = centre.vector + 0.7 * generator.standard_normal(size)
            _, gradient = evidence.loss(centre.with_vector(vector))
            expected = central_difference(
                lambda p: evidence.loss(centre.with_vector(p))[0], vector, np.full(size, 1e-5)
            )
            np.testing.assert_allclose(gradient.vector, expected, rtol=1e-6, atol=1e-6)

    def test_loss_is_the_negative_log_posterior(self) -> None:
        evidence = self.evidence(0.2)

        def expected(log_parameters: LogParameters) -> float:
            found = evidence.hyper_parameters(log_parameters)
            z = self.POINTS / SCALE
            kernel = np.asarray(Matern(nu=2.5)(z / found.length_scale), float)
            # The likelihood of differences of the values, which do not depend on the constant.
            contrast = np.linalg.qr(np.column_stack([np.ones(25), np.eye(25)[:, 1:]]))[0][:, 1:]
            covariance = found.signal_std**2 * kernel + found.noise_std**2 * np.eye(25) + found.slope_std**2 * z @ z.T
            likelihood = multivariate_normal.logpdf(contrast.T @ self.VALUES, cov=contrast.T @ covariance @ contrast)  # pyright: ignore[reportArgumentType]
            medians = np.log([3.0, 3.0, 3.0, 3.0, 0.5, 1.0])
            signal = norm.logpdf(np.log(found.signal_std), np.log(0.25 * 0.2))
            return likelihood + signal + norm.logpdf(log_parameters.vector, medians).sum()

        difference = evidence.loss(self.THERE)[0] - evidence.loss(self.HERE)[0]
        assert difference == pytest.approx(expected(self.HERE) - expected(self.THERE), rel=1e-9)

    def test_without_priors_the_signal_and_the_constant_are_the_most_likely_ones(self) -> None:
        found = self.evidence(None).hyper_parameters(self.HERE)
        process = condition(self.POINTS, self.VALUES, SCALE, found)
        for factor in (0.99, 1.01):
            stds = {name: factor * getattr(found, name) for name in ("signal_std", "noise_std", "slope_std")}
            other = condition(self.POINTS, self.VALUES, SCALE, HyperParameters(found.length_scale, **stds))
            assert log_likelihood(other) < log_likelihood(process)
        factor = process.least_squares.factor
        whitened = np.linalg.solve(factor, np.ones(25)), np.linalg.solve(factor, self.VALUES)
        assert process.coefficient == pytest.approx(np.linalg.lstsq(whitened[0][:, None], whitened[1])[0][0])

    @pytest.mark.parametrize("quadratic_form", [0.0, 1e-30, 1e-4, 3.0, 1e8])
    @pytest.mark.parametrize("size", [1, 2, 30, 300])
    def test_the_signal_is_the_most_probable_one(self, size: int, quadratic_form: float) -> None:
        signal = Evidence(np.zeros((size, 1)), np.zeros(size), 0.2, 1, 1e-9).best_signal(quadratic_form)

        def slope(log_signal: float) -> float:
            return quadratic_form * np.exp(-2 * log_signal) - (size - 1) - (log_signal - np.log(0.05))

        assert slope(np.log(signal) - 1e-6) > 0 > slope(np.log(signal) + 1e-6)


class TestFit:
    @pytest.mark.parametrize(("size", "largest_error"), [(50, 0.0085), (200, 0.004)])
    def test_recovers_a_smooth_function(self, size: int, largest_error: float) -> None:
        process = fit_gaussian_process(*sample(size), SCALE)
        queries, observed = sample(2000, seed=5)
        error = process.mean(queries) - truth(queries)
        covered = np.abs(error) < norm.ppf(0.975) * process.kriging_std(queries)
        observations = np.abs(process.mean(queries) - observed) < norm.ppf(0.975) * process.kriging_std(
            queries, include_noise=True
        )
        assert np.sqrt(np.mean(error**2)) < largest_error
        assert 0.85 < covered.mean() < 0.995
        assert 0.90 < observations.mean() < 0.995
        assert process.hyper_parameters.noise_std == pytest.approx(0.008, rel=0.4)

    @pytest.mark.parametrize(("size", "decisive"), [(20, 0), (20, 1), (20, 2), (20, 3), (COLD_START_SIZE + 60, 1)])
    def test_no_other_search_ends_higher(self, size: int, decisive: int) -> None:
        points, noise = sample(size, seed=12)
        values = np.sin(9 * (points - CENTRE)[:, decisive] / SCALE[decisive]) + noise
        hyper_parameters = fit_gaussian_process(points, values, SCALE).hyper_parameters
        evidence = Evidence(points / SCALE, values, float(np.ptp(values)) / 2, 4, 1e-9)
        ratio = hyper_parameters.noise_std / hyper_parameters.signal_std
        at = LogParameters(np.log(hyper_parameters.length_scale), math.log(ratio))
        found, gradient = evidence.loss(at)
        assert np.abs(gradient.vector).max() < 0.05

        def loss(vector: Array) -> tuple[float, Array]:
            value, gradient = evidence.loss(at.with_vector(vector))
            return value, gradient.vector

        generator = np.random.default_rng(7)
        for start in np.log([2.0, 2.0, 2.0, 2.0, 0.2]) + generator.standard_normal((5, 5)):
            other = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[(-4, 4)] * 5)
            assert found < other.fun + 1e-3

    def test_priors_keep_a_small_fit_from_mistaking_noise_for_signal(self) -> None:
        for seed in range(5):
            generator = np.random.default_rng(seed)
            points = CENTRE + SCALE * generator.uniform(-1, 1, (20, 4))
            hyper_parameters = fit_gaussian_process(points, generator.standard_normal(20), SCALE).hyper_parameters
            assert hyper_parameters.noise_std > 0.05 * hyper_parameters.signal_std

    @pytest.mark.parametrize("size", [1, 2, 3, 5, 10, 40])
    def test_equal_values_leave_uncertainty(self, size: int) -> None:
        points, _ = sample(size)
        process = fit_gaussian_process(points, np.full(size, 0.03), SCALE, 0.2)
        queries, _ = sample(20, seed=10)
        np.testing.assert_allclose(process.mean(queries), 0.03, rtol=1e-9)
        doubt = process.kriging_std(queries, include_noise=True) / 0.2
        assert np.all(doubt > max(1e-3, 0.2 * math.exp(-size)))
        assert np.all(doubt < 0.6)

    def test_many_values_outweigh_the_scale_of_the_values(self) -> None:
        points, values = sample(30)
        one, other = (fit_gaussian_process(points, values, SCALE, scale) for scale in (0.05, 1.0))
        queries, _ = sample(20, seed=10)
        np.testing.assert_allclose(other.mean(queries), one.mean(queries), atol=0.006)  # less than the noise
        np.testing.assert_allclose(
            other.kriging_std(queries, include_noise=True), one.kriging_std(queries, include_noise=True), rtol=0.25
        )

    @pytest.mark.parametrize("basis", ["constant", "linear"])
    def test_intervals_have_the_nominal_coverage(self, basis: Basis) -> None:
        covered = []
        for seed in range(12):
            process = fit_gaussian_process(*sample(30, seed=100 + seed), SCALE, 0.2, basis=basis)
            queries, observed = sample(300, seed=200 + seed)
            error = np.abs(observed - process.mean(queries))
            covered.append(np.mean(error < norm.ppf(0.975) * process.kriging_std(queries, include_noise=True)))
        assert 0.92 < np.mean(covered) < 0.98

    def test_slopes_extrapolate_where_there_are_no_data(self) -> None:
        slope = np.array([0.04, -0.03, 0.0, 0.02])
        points, noise = sample(60, seed=3)
        values = ((points - CENTRE) / SCALE) @ slope + 0.1 * (noise - truth(points))
        constant, linear = (fit_gaussian_process(points, values, SCALE, 0.2, basis=basis) for basis in BASES)
        far = CENTRE + 3 * SCALE * np.sign(slope)
        expected = 3 * np.abs(slope).sum()
        assert linear.mean(far) == pytest.approx(expected, rel=0.1)
        assert abs(constant.mean(far) - expected) > abs(linear.mean(far) - expected)
        assert linear.mean(far) == pytest.approx(expected, abs=2 * float(linear.kriging_std(far)))
        np.testing.assert_allclose(linear.mean_gradient(far) * SCALE, slope, atol=0.01)

    def test_a_direction_without_data_remains_uncertain(self) -> None:
        points, values = sample(40)
        points[:, 3] = CENTRE[3]
        process = fit_gaussian_process(points, values, SCALE, 0.2, basis="linear")
        known, unknown = process.kriging_std(CENTRE), process.kriging_std(CENTRE + SCALE * [0, 0, 0, 1])
        assert np.isfinite(process.mean_gradient(CENTRE)).all()
        assert unknown > 1.5 * known

    def test_units_of_inputs_and_outputs_do_not_matter(self) -> None:
        points, values = sample(40)
        units = np.array([3.6, 1000.0, 0.001, 0.2])
        process = fit_gaussian_process(points, values, SCALE)
        other = fit_gaussian_process(points * units, 1000 * values - 7, SCALE * units)
        queries, _ = sample(10, seed=8)
        np.testing.assert_allclose(other.mean(queries * units), 1000 * process.mean(queries) - 7, rtol=1e-4, atol=1e-2)
        np.testing.assert_allclose(other.kriging_std(queries * units), 1000 * process.kriging_std(queries), rtol=1e-3)

    def test_fitrgp_is_a_maximum_of_the_likelihood_in_raw_units(self) -> None:
        points, values = sample(60, seed=9)
        points = points / SCALE
        process = fit_like_fitrgp(points, values)
        found = process.hyper_parameters
        assert np.ptp(found.length_scale) == 0
        np.testing.assert_array_equal(process.input_scale, 1)
        for length, signal, noise in np.exp(0.1 * np.vstack([np.eye(3), -np.eye(3)])):
            moved = HyperParameters(length * found.length_scale, signal * found.signal_std, noise * found.noise_std)
            assert log_likelihood(condition(points, values, np.ones(4), moved)) < log_likelihood(process)

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
        fit_gaussian_process(points, values, scale, 0.1, basis="linear"),
        fit_like_fitrgp(points, values),
        condition(points, values, scale, HyperParameters(3 * scale, 1.0, 0.0)),
    ]
    queries = np.concatenate([points, np.full((1, points.shape[1]), 0.3)])
    largest = np.abs(values).max()
    for process in processes:
        assert math.isfinite(log_likelihood(process))
        assert np.all(np.isfinite(process.mean_gradient(queries)))
        assert np.all(process.std(queries) >= 0)
        assert np.all(process.std(queries) <= process.kriging_std(queries))
        assert np.all(np.isfinite(process.kriging_std(queries, include_noise=True)))
    for process in processes[:3]:
        assert np.all(process.kriging_std(queries, include_noise=True) > 0)
        assert np.all(np.abs(process.mean(queries)) <= 3 * largest)


@pytest.mark.parametrize("fit", [lambda p, v: fit_gaussian_process(p, v, SCALE), fit_like_fitrgp], ids=["gp", "fitrgp"])
def test_constant_values_are_predicted_everywhere(fit: Callable[[Array, Array], GaussianProcess]) -> None:
    points, _ = sample(40)
    process = fit(points, np.full(40, 0.03))
    queries, _ = sample(20, seed=10)
    np.testing.assert_allclose(process.mean(queries), 0.03, rtol=1e-9)
    np.testing.assert_allclose(process.mean_gradient(queries), 0, atol=1e-9)
    assert np.all(process.kriging_std(queries) < 1e-5)


class TestSaved:
    def test_is_restored_bit_for_bit(self) -> None:
        process = fit_gaussian_process(*sample(60), SCALE)
        loaded = process_from_dict(json.loads(json.dumps(process.to_dict(), allow_nan=False)))
        queries, _ = sample(50, seed=11)
        assert loaded.to_dict() == process.to_dict()
        assert log_likelihood(loaded) == log_likelihood(process)
        for method in ("mean", "mean_gradient", "std", "kriging_std"):
            np.testing.assert_array_equal(getattr(loaded, method)(queries), getattr(process, method)(queries))

    @pytest.mark.parametrize(
        ("key", "wrong"),
        [
            *itertools.product(
                ["input_scale", "points", "values", "length_scale", "signal_std", "noise_std", "slope_std"],
                [None, "0.1", True, [], [[1.0], [1.0, 2.0]], {"1": 1.0}],
            ),
            *itertools.product(["input_scale", "length_scale"], [[1.0, 1.0, 1.0, np.nan], [1.0, 1.0, 1.0, 0.0]]),
            *itertools.product(["signal_std", "noise_std", "slope_std"], [-1.0, np.nan, np.inf]),
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
        with pytest.raises(ValueError, match=rf"^{key}\b.* must be"):
            process_from_dict({**saved, key: wrong})

    def test_a_missing_entry_is_named(self) -> None:
        saved = condition(*sample(3), SCALE, FIXED).to_dict()
        for key in saved.keys() - {"kernel"}:  # which former versions did not write
            with pytest.raises(ValueError, match=f"^{key} must be .* missing"):
                process_from_dict({name: entry for name, entry in saved.items() if name != key})


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
def test_invalid_data_are_refused(points: Array, values: Array, scale: Array, named: str) -> None:
    with pytest.raises(ValueError, match=rf"^{named}\b.* must be"):
        fit_gaussian_process(points, values, scale)


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, np.inf])
def test_an_invalid_value_scale_is_refused(scale: float) -> None:
    with pytest.raises(ValueError, match=r"^value_scale = .* must be"):
        fit_gaussian_process(np.zeros((3, 4)), np.zeros(3), SCALE, scale)
