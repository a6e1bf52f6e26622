"""Gaussian process of many steps: variational inducing points stand for the data.

The model of `gaussian_process`, and the best approximation of its posterior among those that know f at M inducing
points only (Titsias, Variational Learning of Inducing Variables in Sparse Gaussian Processes, 2009, Eqs. 6, 10).
With the features φ = (L⁻¹k, lean, 1) of a point, where k is its covariance with the inducing points and L Lᵀ that
of these among each other, it is a linear regression on φ with the precision A = diag(1, …, 1, 0) + Σφφᵀ/ν, where
ν = (noise/signal)².
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Unpack, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import pdist

from stepgap.learning.cholesky import Factor, factorise
from stepgap.learning.covariance import Covariance, covariance_matrix, kernel
from stepgap.learning.gaussian_process import (
    GaussianProcess,
    HyperParameters,
    append,
    check_sizes,
    checked_data,
    leave_one_out,
    leave_out,
    require,
    saved_hyper_parameters,
)
from stepgap.learning.gaussian_process_fit import Search, fit_gaussian_process
from stepgap.learning.saved import numbers
from stepgap.step import Array

EXACT_SIZE = 2000
"""Most points for which `fit_process` takes the exact process."""

SEARCH_SIZE = 1000
"""Points from which `fit_sparse` takes the hyper-parameters, by an exact fit."""

INDUCING_SIZES = (50, 100, 200, 400, 800)
"""Numbers of inducing points that `fit_sparse` tries, in turn."""

LEAST_GAIN = 0.005
"""Gain of the mean log predictive density of held-out values that is worth twice as many inducing points [nats]."""


@final
@dataclass(frozen=True, eq=False)
class Regression:
    """What the data say of the weights of the features; sums over the points, so that one more is easily added.

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
    def weights(self) -> Array:
        """A⁻¹ moment, the expected weights; shape (F,) [unit of the values]."""
        return self.factor.solve_transposed(self.factor.solve(self.moment))


@final
@dataclass(frozen=True, eq=False)
class SparseGaussianProcess:
    """A Gaussian process conditioned on many data; made by `condition_sparse` or `fit_sparse`.

    Its queries and methods are those of `GaussianProcess`; their cost grows with M² instead of N².

    Attributes:
        points: Inputs; shape (N, d).
        values: Outputs; shape (N,).
        input_scale: Fixed size of each input; shape (d,).
        hyper_parameters: Length scales, signal, noise and slopes.
        inducing: Inputs at which f stands for the data; shape (M, d).
        inducing_factor: Cholesky factor of their covariance / signal²; shape (M, M).
        regression: What the data say at these hyper-parameters.
    """

    points: Array
    values: Array
    input_scale: Array
    hyper_parameters: HyperParameters
    inducing: Array
    inducing_factor: Factor
    regression: Regression

    @property
    def coefficient(self) -> float:
        """β [unit of the values]."""
        return float(self.regression.weights[-1])

    def mean(self, point: ArrayLike) -> Array:
        """Expected value; shape (…) [unit of the values]."""
        covariance, (weights, rise) = self._covariance, self._mean_weights

        def mean(query: Array) -> Array:
            return self.coefficient + covariance.kernel(query) @ weights + covariance.lean(query) @ rise

        return covariance.blockwise(mean, point)

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d) [unit of the values per unit of each input]."""
        covariance, (weights, rise) = self._covariance, self._mean_weights
        slope = rise * covariance.steepness
        return covariance.blockwise(lambda query: covariance.kernel_gradient(query, weights) + slope, point)

    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Plug-in standard deviation, which takes β for exact; shape (…) [unit of the values]."""

        def variance(query: Array) -> Array:
            features = self._features(query)
            return self._unexplained(features) + (self.regression.factor.solve(features)[:-1] ** 2).sum(axis=0)

        return self.hyper_parameters.std(self._covariance.blockwise(variance, point), include_noise)

    def kriging_std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Standard deviation with β only estimated; shape (…) [unit of the values]."""

        def variance(query: Array) -> Array:
            features = self._features(query)
            return self._unexplained(features) + (self.regression.factor.solve(features) ** 2).sum(axis=0)

        return self.hyper_parameters.std(self._covariance.blockwise(variance, point), include_noise)

    def kriging_std_gradient(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """∂kriging_std/∂point; shape (…, d) [unit of the values per unit of each input]."""
        covariance, size = self._covariance, len(self.inducing)

        def half_variance_gradient(query: Array) -> Array:
            features = self._features(query)
            response = self.regression.factor.solve_transposed(self.regression.factor.solve(features))
            weights = self.inducing_factor.solve_transposed(features[:size] - response[:size]).T
            return response[size:-1].T * covariance.steepness - covariance.kernel_gradient(query, weights)

        half = covariance.blockwise(half_variance_gradient, point)
        return self.hyper_parameters.std_gradient(half, self.kriging_std(point, include_noise=include_noise))

    def to_dict(self) -> dict[str, Any]:
        """Data, hyper-parameters and inducing points as JSON-ready numbers; everything else follows from them."""
        return {
            "inducing": self.inducing.tolist(),
            "input_scale": self.input_scale.tolist(),
            "points": self.points.tolist(),
            "values": self.values.tolist(),
            "length_scale": self.hyper_parameters.length_scale.tolist(),
            "signal_std": self.hyper_parameters.signal_std,
            "noise_std": self.hyper_parameters.noise_std,
            "slope_std": self.hyper_parameters.slope_std,
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "SparseGaussianProcess":
        """The process that `to_dict` saved.

        Raises:
            ValueError: A key is missing, or holds anything but finite numbers of the right size and sign.
        """
        arrays = (
            numbers(data, "points", 2),
            numbers(data, "values", 1),
            numbers(data, "input_scale", 1),
        )
        inducing = numbers(data, "inducing", 2)
        return condition_sparse(*arrays, saved_hyper_parameters(data), inducing)

    @cached_property
    def _covariance(self) -> Covariance:
        """Of queries and the inducing points."""
        return self.hyper_parameters.covariance(self.inducing, self.inducing[0], self.input_scale)

    @cached_property
    def _mean_weights(self) -> tuple[Array, Array]:
        """Of the covariances with the inducing points (M,), and of the lean (d,)."""
        size, weights = len(self.inducing), self.regression.weights
        return self.inducing_factor.solve_transposed(weights[:size]), weights[size:-1]

    def _features(self, query: Array) -> Array:
        """φ of queries (Q, d); shape (F, Q)."""
        return _features(self._covariance, self.inducing_factor, query)

    def _unexplained(self, features: Array) -> Array:
        """Variance of f that the inducing points leave even if known [signal²]; shape (Q,)."""
        return np.maximum(1 - (features[: len(self.inducing)] ** 2).sum(axis=0), 0)


Process = GaussianProcess | SparseGaussianProcess
"""What `fit_process` gives."""


def condition_sparse(
    points: ArrayLike,
    values: ArrayLike,
    input_scale: ArrayLike,
    hyper_parameters: HyperParameters,
    inducing: ArrayLike,
) -> SparseGaussianProcess:
    """Sparse Gaussian process given the data, at fixed hyper-parameters and inducing points.

    Args:
        points: Shape (N, d), N ≥ 1.
        values: Shape (N,).
        input_scale: Fixed size of each input, not taken from the data; shape (d,).
        hyper_parameters: `noise_std` must be positive.
        inducing: Shape (M, d), M ≥ 1.
    """
    points, values, input_scale = checked_data(points, values, input_scale)
    check_sizes(hyper_parameters, input_scale)
    require(hyper_parameters.noise_std > 0, "noise_std", "positive for a sparse process")
    inducing = np.array(inducing, float)
    sized = inducing.ndim == 2 and len(inducing) > 0 and inducing.shape[1] == len(input_scale)
    require(
        sized and np.isfinite(inducing).all(), "inducing", f"finite and of shape (M, {len(input_scale)}) with M ≥ 1"
    )
    covariance = hyper_parameters.covariance(inducing, inducing[0], input_scale)
    distance = np.sqrt(5 * pdist(inducing / covariance.reach, "sqeuclidean"))
    factor = factorise(covariance_matrix(kernel(distance), np.zeros((len(inducing), 0)), 0.0))
    features = _features(covariance, factor, points)
    ratio = (hyper_parameters.noise_std / hyper_parameters.signal_std) ** 2
    precision = features @ features.T / ratio
    precision[np.diag_indices(len(precision) - 1)] += 1
    regression = Regression(np.ascontiguousarray(precision), features @ values / ratio)
    return SparseGaussianProcess(points, values, input_scale, hyper_parameters, inducing, factor, regression)


def fit_sparse(
    points: ArrayLike,
    values: ArrayLike,
    input_scale: ArrayLike,
    value_scale: float | None = None,
    **search: Unpack[Search],
) -> SparseGaussianProcess:
    """Sparse Gaussian process whose hyper-parameters an exact fit to some of the points chose.

    Inducing points are chosen among the points, each where the others leave most variance (Burt and others,
    Convergence of Sparse Variational Inference in Gaussian Processes Regression, 2020); there are as many as
    predict held-out values, every fifth, better.

    Args:
        points: Shape (N, d), N ≥ 1.
        values: Shape (N,).
        input_scale: Fixed size of each input, not taken from the data; shape (d,).
        value_scale: As for `fit_gaussian_process`.
        search: As for `fit_gaussian_process`.
    """
    points, values, input_scale = checked_data(points, values, input_scale)
    some = np.unique(np.linspace(0, len(values) - 1, SEARCH_SIZE).astype(int))
    found = fit_gaussian_process(points[some], values[some], input_scale, value_scale, **search).hyper_parameters
    held_out = np.arange(len(values)) % 5 == 4
    size, best = INDUCING_SIZES[0], -np.inf
    for candidate in INDUCING_SIZES:
        inducing = spread_points(points[~held_out], input_scale, found, candidate)
        process = condition_sparse(points[~held_out], values[~held_out], input_scale, found, inducing)
        score = _log_density(process, points[held_out], values[held_out]) if held_out.any() else -np.inf
        if score < best + LEAST_GAIN:
            break
        size, best = candidate, score
    return condition_sparse(points, values, input_scale, found, spread_points(points, input_scale, found, size))


def fit_process(
    points: ArrayLike,
    values: ArrayLike,
    input_scale: ArrayLike,
    value_scale: float | None = None,
    **search: Unpack[Search],
) -> Process:
    """`fit_gaussian_process`, or `fit_sparse` for more than `EXACT_SIZE` points."""
    fit = fit_sparse if len(np.asarray(values)) > EXACT_SIZE else fit_gaussian_process
    return fit(points, values, input_scale, value_scale, **search)


def process_from_dict(data: Mapping[str, Any]) -> Process:
    """The process, exact or sparse, that `to_dict` saved.

    Raises:
        ValueError: A key is missing, or holds anything but finite numbers of the right size and sign.
    """
    return SparseGaussianProcess.from_dict(data) if "inducing" in data else GaussianProcess.from_dict(data)


def spread_points(points: Array, input_scale: Array, hyper_parameters: HyperParameters, count: int) -> Array:
    """At most `count` of the points, each where those before it leave most variance of f; shape (M, d).

    This is a Cholesky factorisation with pivots; it ends where nothing is left but rounding.
    """
    reach = input_scale * hyper_parameters.length_scale
    scaled = points / reach
    columns = np.empty((count, len(points)))
    left, chosen = np.ones(len(points)), []
    for row in range(min(count, len(points))):
        pick = int(np.argmax(left))
        if left[pick] < 1e-8:
            break
        distance = np.sqrt(5 * ((scaled - scaled[pick]) ** 2).sum(axis=1))
        columns[row] = (kernel(distance) - columns[:row, pick] @ columns[:row]) / np.sqrt(left[pick])
        left = left - columns[row] ** 2
        left[pick] = 0
        chosen.append(pick)
    return points[chosen]


@append.register  # pyright: ignore[reportArgumentType, reportCallIssue]
def _(process: SparseGaussianProcess, point: ArrayLike, value: float) -> SparseGaussianProcess:
    """Sparse Gaussian process given one point more, at the same inducing points, in O(M³) whatever N."""
    new, value_, _ = checked_data(np.asarray(point, float)[None], np.asarray([value]), process.input_scale)
    ratio = (process.hyper_parameters.noise_std / process.hyper_parameters.signal_std) ** 2
    features = process._features(new)[:, 0]
    old = process.regression
    regression = Regression(
        old.precision + np.outer(features, features) / ratio, old.moment + features * value_[0] / ratio
    )
    return SparseGaussianProcess(
        np.concatenate([process.points, new]),
        np.concatenate([process.values, value_]),
        process.input_scale,
        process.hyper_parameters,
        process.inducing,
        process.inducing_factor,
        regression,
    )


@leave_one_out.register
def _(process: SparseGaussianProcess) -> tuple[Array, Array]:
    """As for an exact process, at the same inducing points."""
    signal, noise = process.hyper_parameters.signal_std, process.hyper_parameters.noise_std
    ratio = (noise / signal) ** 2
    features = process._features(process.points)
    leverage = (process.regression.factor.solve(features) ** 2).sum(axis=0) / ratio
    error = process.values - features.T @ process.regression.weights
    kept = np.maximum(1 - leverage, np.finfo(float).tiny)
    variance = process._unexplained(features) + ratio * leverage / kept
    return process.values - error / kept, np.hypot(signal * np.sqrt(variance), noise)


@leave_out.register
def _(process: SparseGaussianProcess, blocks: Sequence[slice]) -> tuple[Array, Array]:
    """As for an exact process, at the same inducing points."""
    signal, noise = process.hyper_parameters.signal_std, process.hyper_parameters.noise_std
    features, known, ratio = process._features(process.points), process.regression, (noise / signal) ** 2
    mean, variance = np.full(len(process.values), np.nan), process._unexplained(features)
    for block in blocks:
        inside = features[:, block]
        others = Regression(
            known.precision - inside @ inside.T / ratio, known.moment - inside @ process.values[block] / ratio
        )
        mean[block] = others.weights @ inside
        variance[block] += (others.factor.solve(inside) ** 2).sum(axis=0)
    return mean, np.hypot(signal * np.sqrt(variance), noise)


def _features(covariance: Covariance, factor: Factor, query: Array) -> Array:
    """φ = (L⁻¹k, lean, 1) of queries (Q, d); shape (F, Q)."""
    known = factor.solve(covariance.kernel(query).T)
    return np.concatenate([known, covariance.lean(query).T, np.ones((1, len(query)))])


def _log_density(process: SparseGaussianProcess, points: Array, values: Array) -> float:
    """Mean log predictive density of values not seen, but for a constant [nats]."""
    std = process.kriging_std(points, include_noise=True)
    return float(np.mean(-np.log(std) - 0.5 * ((values - process.mean(points)) / std) ** 2))
