"""Sparse Gaussian process for many steps: variational inducing points represent the data.

The model is that of `gaussian_process`, with the best approximation of its posterior that depends on f at M inducing
points only (Titsias, Variational Learning of Inducing Variables in Sparse Gaussian Processes, 2009, Eqs. 6, 10).
With the features φ = (L⁻¹k, linear features, 1) of a point, where k is its covariance with the inducing points and
L Lᵀ that of these among each other, it is a linear regression on φ (RW Sec. 2.1) with the precision
A = diag(1, …, 1, 0) + Σφφᵀ/ν, where ν is the variance of the noise [signal²].
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Unpack, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.json_data import numbers
from stepgap.base.normal import log_density
from stepgap.base.ranges import require
from stepgap.gauss.cholesky import Factor, factorise
from stepgap.gauss.covariance import Covariance, covariance_matrix
from stepgap.gauss.exact_gaussian_process import ExactGaussianProcess
from stepgap.gauss.gaussian_process import (
    GaussianProcess,
    HyperParameters,
    LeftOut,
    check_kernel,
    check_sizes,
    checked_data,
    saved_data,
    saved_hyper_parameters,
)
from stepgap.gauss.gaussian_process_fit import EXACT_SIZE, Search, fit_gaussian_process, fit_hyper_parameters
from stepgap.gauss.kernel import MATERN_52, Kernel
from stepgap.step import Array

INDUCING_SIZES = (50, 100, 200, 400, 800)
"""Numbers of inducing points that `fit_sparse` tries, in turn."""

LARGEST_INDUCING = 1000
"""Largest number of inducing points of a saved process that is read."""

LEAST_GAIN = 0.005
"""Least gain of the mean log predictive density of held-out values that justifies more inducing points [nats]."""


@final
@dataclass(frozen=True, eq=False)
class WeightPosterior:
    """Posterior of the weights of the features; its attributes are sums over the points, to which one can be added.

    Attributes:
        precision: A, its upper triangle; shape (F, F) with F = M + d + 1.
        moment: Σφ·value/ν; shape (F,).
    """

    precision: Array
    moment: Array

    @cached_property
    def factor(self) -> Factor:
        """Cholesky factor of A."""
        return factorise(self.precision.copy())

    @cached_property
    def mean(self) -> Array:
        """A⁻¹ moment, the expected weights; shape (F,) [unit of the values]."""
        return self.factor.solve_transposed(self.factor.solve(self.moment))


@final
@dataclass(frozen=True, eq=False)
class SparseGaussianProcess(GaussianProcess):
    """A Gaussian process conditioned on many data; created by `condition_sparse` or `fit_sparse`.

    The cost of a query grows with M² instead of N².

    Attributes:
        inducing: Inducing points; shape (M, d).
        inducing_factor: Cholesky factor of their covariance / signal²; shape (M, M).
        posterior: Posterior of the weights at these hyper-parameters.
    """

    inducing: Array
    inducing_factor: Factor
    posterior: WeightPosterior

    @property
    def coefficient(self) -> float:
        """β [unit of the values]."""
        return float(self.posterior.mean[-1])

    def append(self, point: ArrayLike, value: float) -> "SparseGaussianProcess":
        """Conditions the process on one more point, at the same inducing points, in O(M³), independent of N."""
        new_point, new_value, _ = checked_data(np.asarray(point, float)[None], np.asarray([value]), self.input_scale)
        features, noise = self._features(new_point)[:, 0], self.hyper_parameters.noise_variance
        posterior = WeightPosterior(
            self.posterior.precision + np.outer(features, features) / noise,
            self.posterior.moment + features * new_value[0] / noise,
        )
        return replace(
            self,
            points=np.concatenate([self.points, new_point]),
            values=np.concatenate([self.values, new_value]),
            posterior=posterior,
        )

    def leave_one_out(self) -> LeftOut:
        """Leave-one-out predictions, at the same inducing points."""
        found, features = self.hyper_parameters, self._features(self.points)
        conditional, squares = self._conditional_variance(features), self.posterior.factor.solve(features) ** 2
        stds = []
        for terms in (squares[:-1], squares):  # without and with the constant, as in the variances below
            leverage = terms.sum(axis=0) / found.noise_variance
            kept = np.maximum(1 - leverage, np.finfo(float).tiny)
            stds.append(found.std(conditional + found.noise_variance * leverage / kept, include_noise=True))
        error = self.values - features.T @ self.posterior.mean
        return LeftOut(self.values - error / kept, *stds)

    def leave_out(self, blocks: Sequence[slice]) -> LeftOut:
        """Leave-block-out predictions, at the same inducing points."""
        features, posterior, noise = self._features(self.points), self.posterior, self.hyper_parameters.noise_variance
        mean, variance = np.full(len(self.values), np.nan), self._conditional_variance(features)
        kriging_variance = variance.copy()
        for block in blocks:
            inside = features[:, block]
            others = WeightPosterior(
                posterior.precision - inside @ inside.T / noise, posterior.moment - inside @ self.values[block] / noise
            )
            mean[block] = others.mean @ inside
            squares = others.factor.solve(inside) ** 2
            variance[block] += squares[:-1].sum(axis=0)
            kriging_variance[block] += squares.sum(axis=0)
        stds = (self.hyper_parameters.std(each, include_noise=True) for each in (variance, kriging_variance))
        return LeftOut(mean, *stds)

    def to_dict(self) -> dict[str, Any]:
        """Converts data, hyper-parameters and inducing points to JSON-ready numbers."""
        return {"inducing": self.inducing.tolist(), **super().to_dict()}

    @staticmethod
    def from_dict(data: Mapping[str, Any], kernel: Kernel = MATERN_52) -> "SparseGaussianProcess":
        """Restores the process that `to_dict` saved.

        Raises:
            ValueError: A key is missing, its value is not finite numbers of the right size and sign, or the data are
                of another kernel.
        """
        check_kernel(data, kernel)
        arrays, inducing = saved_data(data), numbers(data, "inducing", 2)
        rule = f"have at most {LARGEST_INDUCING} rows"
        require(len(inducing) <= LARGEST_INDUCING, "inducing.shape", inducing.shape, rule)
        return condition_sparse(*arrays, saved_hyper_parameters(data), inducing, kernel)

    @property
    def _centres(self) -> Array:
        return self.inducing

    def _solve_weights(self) -> tuple[Array, Array]:
        size, weights = len(self.inducing), self.posterior.mean
        return self.inducing_factor.solve_transposed(weights[:size]), weights[size:-1]

    def _variance(self, query: Array) -> Array:
        features = self._features(query)
        # The last feature is the constant, which the factor eliminates last: without it, β is treated as exact.
        return self._conditional_variance(features) + (self.posterior.factor.solve(features)[:-1] ** 2).sum(axis=0)

    def _kriging_variance(self, query: Array) -> Array:
        features = self._features(query)
        return self._conditional_variance(features) + (self.posterior.factor.solve(features) ** 2).sum(axis=0)

    def _half_variance_gradient(self, query: Array) -> Array:
        features = self._features(query)
        whitened = self.posterior.factor.solve(features)
        whitened[-1] = 0
        return self._gradient_of(query, features, whitened)

    def _half_kriging_variance_gradient(self, query: Array) -> Array:
        features = self._features(query)
        return self._gradient_of(query, features, self.posterior.factor.solve(features))

    def _gradient_of(self, query: Array, features: Array, whitened: Array) -> Array:
        """½ ∂variance/∂query [signal²], given factor⁻¹ φ, whose squares sum to a part of it (F, Q); shape (Q, d)."""
        covariance, size = self.covariance, len(self.inducing)
        response = self.posterior.factor.solve_transposed(whitened)
        weights = self.inducing_factor.solve_transposed(features[:size] - response[:size]).T
        linear = response[size:-1].T * covariance.slope_scale
        return linear - covariance.cross_covariance_gradient(query, weights)

    def _features(self, query: Array) -> Array:
        """φ of queries (Q, d); shape (F, Q)."""
        return _features(self.covariance, self.inducing_factor, query)

    def _conditional_variance(self, features: Array) -> Array:
        """Variance of f given f at the inducing points [signal²]; shape (Q,)."""
        return np.maximum(1 - (features[: len(self.inducing)] ** 2).sum(axis=0), 0)


def condition_sparse(
    points: ArrayLike,
    values: ArrayLike,
    input_scale: ArrayLike,
    hyper_parameters: HyperParameters,
    inducing: ArrayLike,
    kernel: Kernel = MATERN_52,
) -> SparseGaussianProcess:
    """Conditions a sparse Gaussian process on the data, at fixed hyper-parameters and inducing points.

    Args:
        points: Shape (N, d), N ≥ 1.
        values: Shape (N,).
        input_scale: Fixed size of each input, not taken from the data; shape (d,).
        hyper_parameters: `noise_std` must be positive.
        inducing: Shape (M, d), M ≥ 1.
        kernel: Covariance of f.
    """
    points, values, input_scale = checked_data(points, values, input_scale)
    check_sizes(hyper_parameters, input_scale)
    noise_std = hyper_parameters.noise_std
    require(noise_std > 0, "noise_std", noise_std, "be positive for a sparse process")
    inducing = np.array(inducing, float)
    sized = inducing.ndim == 2 and len(inducing) > 0 and inducing.shape[1] == len(input_scale)
    require(sized, "inducing.shape", inducing.shape, f"be (M, {len(input_scale)}) with M ≥ 1")
    require(np.isfinite(inducing).all(), "inducing", inducing, "be finite")
    covariance = hyper_parameters.covariance(kernel, inducing, input_scale)
    factor = factorise(covariance_matrix(covariance.correlation_of_centres(), np.zeros((len(inducing), 0)), 0.0))
    features = _features(covariance, factor, points)
    noise = hyper_parameters.noise_variance
    precision = features @ features.T / noise
    precision[np.diag_indices(len(precision) - 1)] += 1
    posterior = WeightPosterior(np.ascontiguousarray(precision), features @ values / noise)
    return SparseGaussianProcess(points, values, input_scale, hyper_parameters, kernel, inducing, factor, posterior)


def fit_sparse(
    points: ArrayLike,
    values: ArrayLike,
    input_scale: ArrayLike,
    value_scale: float | None = None,
    **search: Unpack[Search],
) -> SparseGaussianProcess:
    """Fits a sparse Gaussian process; its hyper-parameters are those of `fit_hyper_parameters`.

    Args:
        points: Shape (N, d), N ≥ 1.
        values: Shape (N,).
        input_scale: Fixed size of each input, not taken from the data; shape (d,).
        value_scale: As for `fit_hyper_parameters`.
        search: As for `fit_hyper_parameters`.
    """
    found = fit_hyper_parameters(points, values, input_scale, value_scale, **search)
    return condition_as_needed(points, values, input_scale, found, search.get("kernel", MATERN_52))


def condition_as_needed(
    points: ArrayLike,
    values: ArrayLike,
    input_scale: ArrayLike,
    found: HyperParameters,
    kernel: Kernel = MATERN_52,
) -> SparseGaussianProcess:
    """Conditions a sparse process with as many inducing points as it needs.

    Each inducing point is the point of largest variance given those before it (Burt and others, Convergence of
    Sparse Variational Inference in Gaussian Processes Regression, 2020). Their number grows as long as this
    improves the prediction of held-out values, every fifth one.

    Args:
        points: Shape (N, d), N ≥ 1.
        values: Shape (N,).
        input_scale: Fixed size of each input, not taken from the data; shape (d,).
        found: Hyper-parameters; `noise_std` must be positive.
        kernel: Covariance of f.
    """
    points, values, input_scale = checked_data(points, values, input_scale)
    held_out = np.arange(len(values)) % 5 == 4
    size, best = INDUCING_SIZES[0], -np.inf
    for candidate in INDUCING_SIZES:
        inducing = spread_points(points[~held_out], input_scale, found, candidate, kernel)
        process = condition_sparse(points[~held_out], values[~held_out], input_scale, found, inducing, kernel)
        score = _score(process, points[held_out], values[held_out]) if held_out.any() else -np.inf
        if score < best + LEAST_GAIN:
            break
        size, best = candidate, score
    inducing = spread_points(points, input_scale, found, size, kernel)
    return condition_sparse(points, values, input_scale, found, inducing, kernel)


def fit_process(
    points: ArrayLike,
    values: ArrayLike,
    input_scale: ArrayLike,
    value_scale: float | None = None,
    **search: Unpack[Search],
) -> GaussianProcess:
    """Fits by `fit_gaussian_process`, or by `fit_sparse` for more than `EXACT_SIZE` points."""
    fit = fit_sparse if len(np.asarray(values)) > EXACT_SIZE else fit_gaussian_process
    return fit(points, values, input_scale, value_scale, **search)


def process_from_dict(data: Mapping[str, Any], kernel: Kernel = MATERN_52) -> GaussianProcess:
    """Restores the process, exact or sparse, that `to_dict` saved.

    Raises:
        ValueError: A key is missing, or its value is not finite numbers of the right size and sign.
    """
    kind = SparseGaussianProcess if "inducing" in data else ExactGaussianProcess
    return kind.from_dict(data, kernel)


def spread_points(
    points: Array, input_scale: Array, hyper_parameters: HyperParameters, count: int, kernel: Kernel = MATERN_52
) -> Array:
    """Selects at most `count` points, each where the variance of f given those before it is largest; shape (M, d).

    This is a pivoted Cholesky factorisation; it ends where only rounding errors remain.
    """
    scaled = points / (input_scale * hyper_parameters.length_scale)
    columns = np.empty((count, len(points)))
    remaining, chosen = np.ones(len(points)), []
    # `columns` has the Cholesky factor of the chosen points, continued to all points, and `remaining` the variance of
    # f at each point given them [signal²]. A column costs O(N · row), and no matrix of all points is ever made.
    for row in range(min(count, len(points))):
        pick = int(np.argmax(remaining))
        if remaining[pick] < 1e-8:
            break
        correlation = kernel.covariance(((scaled - scaled[pick]) ** 2).sum(axis=1))
        columns[row] = (correlation - columns[:row, pick] @ columns[:row]) / np.sqrt(remaining[pick])
        remaining = remaining - columns[row] ** 2
        remaining[pick] = 0
        chosen.append(pick)
    return points[chosen]


def _features(covariance: Covariance, factor: Factor, query: Array) -> Array:
    """φ = (L⁻¹k, linear features, 1) of queries (Q, d); shape (F, Q)."""
    whitened = factor.solve(covariance.cross_covariance(query).T)
    return np.concatenate([whitened, covariance.linear_features(query).T, np.ones((1, len(query)))])


def _score(process: SparseGaussianProcess, points: Array, values: Array) -> float:
    """Mean log predictive density of held-out values [nats]."""
    std = process.kriging_std(points, include_noise=True)
    return float(np.mean(log_density(values - process.mean(points), std)))
