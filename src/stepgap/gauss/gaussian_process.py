"""Gaussian process regression of one output with explicit basis functions: a constant and, optionally, slopes.

The model is value = β + slopes · point + f(point) + noise:

- β, the constant, has a flat prior, as in the paper's `fitrgp` call (Sec. 6).
- Each slope, per `input_scale`, has the prior N(0, slope_std²); slope_std = 0 gives the model of the paper.
- f has zero mean and the covariance signal_std² k(r), where k is a stationary `Kernel` and r the distance of two
  points, each input divided by `input_scale · length_scale`.
- The noise is independent, with the standard deviation noise_std.

All parts are estimated jointly. An `ExactGaussianProcess` knows f at all N points. For many, a `SparseGaussianProcess`
has the best approximation of its posterior that depends on f at M inducing points only (Titsias, Variational Learning
of Inducing Variables in Sparse Gaussian Processes, 2009, Eqs. 6, 10); if these are all points, both are the same.

Variances and covariances in this module are divided by signal_std²; their unit is written [signal²]. Equations marked
RW are those of Rasmussen and Williams, Gaussian Processes for Machine Learning (2006).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Self, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.json_data import number, numbers
from stepgap.base.ranges import require
from stepgap.gauss.covariance import Covariance, covariance_matrix
from stepgap.gauss.kernel import MATERN_52, Kernel
from stepgap.gauss.least_squares import LeastSquares, factorise, fit_least_squares, solve, solve_transposed
from stepgap.step import Array

LARGEST_SAVED = 6000
"""Largest number of points of a saved exact process that is read; the memory grows with its square."""

LARGEST_INDUCING = 1000  # Largest number of inducing points of a saved process that is read


@final
@dataclass(frozen=True, eq=False)
class HyperParameters:
    """Hyper-parameters; `gaussian_process_fit` estimates them.

    Attributes:
        length_scale: Distance over which f changes, in units of `input_scale`; shape (d,).
        signal_std: Standard deviation of f [unit of the values].
        noise_std: Standard deviation of the noise of one value [unit of the values].
        slope_std: Prior standard deviation of each slope [unit of the values per input scale].
    """

    length_scale: Array
    signal_std: float
    noise_std: float
    slope_std: float = 0.0

    def __post_init__(self) -> None:
        require(_positive(self.length_scale), "length_scale", self.length_scale, "be positive and finite")
        require(_positive(self.signal_std), "signal_std", self.signal_std, "be positive and finite")
        for name in ("noise_std", "slope_std"):
            std = getattr(self, name)
            require(std == 0 or _positive(std), name, std, "be non-negative and finite")

    @property
    def noise_variance(self) -> float:
        """Variance of the noise of one value [signal²]."""
        return (self.noise_std / self.signal_std) ** 2

    def covariance(self, kernel: Kernel, centres: Array, input_scale: Array) -> Covariance:
        """Covariance of queries and fixed centres (M, d).

        The linear features are zero at the first centre; as β is free, any other point would give the same model.
        """
        slope_scale = self.slope_std / self.signal_std / input_scale
        return Covariance(kernel, centres, centres[0], input_scale * self.length_scale, slope_scale)

    def std(self, variance: Array, include_noise: bool) -> Array:
        """Standard deviation [unit of the values] of a variance [signal²], without or with the noise."""
        # Rounding can leave a variance slightly below zero at a point that was observed.
        std = self.signal_std * np.sqrt(np.maximum(variance, 0))
        return np.hypot(std, self.noise_std) if include_noise else std

    def std_gradient(self, half_variance_gradient: Array, std: Array) -> Array:
        """∂std/∂point = ½ ∂variance/∂point / std, given ½ ∂variance/∂point [signal²] (…, d) and `std` (…)."""
        half = self.signal_std**2 * half_variance_gradient
        return np.divide(half, std[..., None], out=np.zeros_like(half), where=std[..., None] != 0)


class LeftOut(NamedTuple):
    """Predictions of values from others, with the same hyper-parameters; shapes (N,) [unit of the values].

    Attributes:
        mean: Expected values.
        std: Standard deviations as `GaussianProcess.std(…, include_noise=True)`, with the β of the others.
        kriging_std: Standard deviations as `GaussianProcess.kriging_std(…, include_noise=True)`.
    """

    mean: Array
    std: Array
    kriging_std: Array


@dataclass(frozen=True, eq=False)
class GaussianProcess(ABC):
    """A Gaussian process conditioned on data; everything else follows from its fields.

    Query points have shape (…, d) and the units of `points`; where one is not finite, the result is NaN.

    Attributes:
        points: Inputs; shape (N, d).
        values: Outputs; shape (N,).
        input_scale: Fixed scale of each input, the unit of its length scale; shape (d,).
        hyper_parameters: Length scales, signal, noise and slopes.
        kernel: Covariance of f.
    """

    points: Array
    values: Array
    input_scale: Array
    hyper_parameters: HyperParameters
    kernel: Kernel

    @property
    @abstractmethod
    def coefficient(self) -> float:
        """β, the constant of the mean; without slopes, the prediction far from all data [unit of the values]."""

    @abstractmethod
    def leave_out(self, blocks: Sequence[slice]) -> LeftOut:
        """Predicts each value from the values outside its block, from which β is estimated, too.

        Args:
            blocks: Consecutive parts of the values. A block with all values leaves no data for the prediction: the mean
                is NaN and the standard deviation infinite.
        """

    def append(self, point: ArrayLike, value: float) -> Self:
        """The process conditioned on one more point (d,) and value, with the same hyper-parameters."""
        new_point, new_value, _ = checked_data(np.asarray(point, float)[None], np.asarray([value]), self.input_scale)
        points = np.concatenate([self.points, new_point])
        values = np.concatenate([self.values, new_value])
        return replace(self, points=points, values=values)

    def mean(self, point: ArrayLike) -> Array:
        """Expected value; shape (…) [unit of the values] (RW Eq. 2.38)."""
        covariance = self.covariance
        weights, slopes = self.weights

        def mean_of_block(query: Array) -> Array:
            return (
                self.coefficient
                + covariance.cross_covariance(query) @ weights
                + covariance.linear_features(query) @ slopes
            )

        return covariance.blockwise(mean_of_block, point)

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d) [unit of the values per unit of each input]."""
        covariance = self.covariance
        weights, slopes = self.weights
        slope = slopes * covariance.slope_scale
        return covariance.blockwise(lambda query: covariance.cross_covariance_gradient(query, weights) + slope, point)

    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Standard deviation with β taken as known (RW Eq. 2.26); shape (…) [unit of the values].

        With slopes, β is the value at the first centre, and the standard deviation depends on this choice.

        Args:
            point: Shape (…, d).
            include_noise: False: of β + slopes · point + f. True: of a new noisy value, as MATLAB's `predict` returns.
        """
        variance = self.covariance.blockwise(lambda query: self._variances(query)[0], point)
        return self.hyper_parameters.std(variance, include_noise)

    def kriging_std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Standard deviation with the uncertainty of the estimated β (universal kriging, RW Eq. 2.42); shape (…).

        Args:
            point: Shape (…, d).
            include_noise: False: of β + slopes · point + f. True: of a new noisy value.
        """
        variance = self.covariance.blockwise(lambda query: np.add(*self._variances(query)), point)
        return self.hyper_parameters.std(variance, include_noise)

    def std_gradient(self, point: ArrayLike) -> Array:
        """∂std/∂point without noise; shape (…, d) [unit of the values per unit of each input].

        At points without uncertainty the standard deviation has a kink; zero is returned there.
        """
        half = self.covariance.blockwise(lambda query: self._half_variance_gradient(query, kriging=False), point)
        return self.hyper_parameters.std_gradient(half, self.std(point))

    def kriging_std_gradient(self, point: ArrayLike) -> Array:
        """∂kriging_std/∂point without noise, as `std_gradient`; shape (…, d)."""
        half = self.covariance.blockwise(lambda query: self._half_variance_gradient(query, kriging=True), point)
        return self.hyper_parameters.std_gradient(half, self.kriging_std(point))

    def to_dict(self) -> dict[str, Any]:
        """What defines the process, for JSON; `process_from_dict` reads it."""
        return {
            "kernel": self.kernel.name,
            "input_scale": self.input_scale.tolist(),
            "points": self.points.tolist(),
            "values": self.values.tolist(),
            "length_scale": self.hyper_parameters.length_scale.tolist(),
            "signal_std": self.hyper_parameters.signal_std,
            "noise_std": self.hyper_parameters.noise_std,
            "slope_std": self.hyper_parameters.slope_std,
        }

    @property
    def _centres(self) -> Array:
        """Points at which f has weights in the prediction; shape (M, d)."""
        return self.points

    @cached_property
    def covariance(self) -> Covariance:
        """Covariance of queries and the centres."""
        return self.hyper_parameters.covariance(self.kernel, self._centres, self.input_scale)

    @cached_property
    @abstractmethod
    def weights(self) -> tuple[Array, Array]:
        """Weights in the mean: of the covariances with the centres (M,) and of the linear features (d,).

        Their unit is that of the values.
        """

    @abstractmethod
    def _variances(self, query: Array) -> tuple[Array, Array]:
        """Variance with β taken as known, and what the uncertainty of β adds [signal²]; shapes (Q,)."""

    @abstractmethod
    def _half_variance_gradient(self, query: Array, *, kriging: bool) -> Array:
        """½ ∂variance/∂query [signal²], with or without what the uncertainty of β adds; shape (Q, d)."""


@final
@dataclass(frozen=True, eq=False)
class ExactGaussianProcess(GaussianProcess):
    """A Gaussian process that knows f at all points; created by `condition`."""

    @cached_property
    def least_squares(self) -> LeastSquares:
        """β and the weights of the data, with K / signal² = L Lᵀ."""
        covariance = self.covariance
        correlation = covariance.correlation_of_centres()
        noise = self.hyper_parameters.noise_variance
        matrix = covariance_matrix(correlation, covariance.centre_features, noise)
        return fit_least_squares(factorise(matrix), self.values)

    @property
    def coefficient(self) -> float:
        """β by generalised least squares [unit of the values]."""
        return self.least_squares.coefficient

    @cached_property
    def weights(self) -> tuple[Array, Array]:
        """Weights in the mean: of the covariances with the points (N,) and of the linear features (d,)."""
        weights = self.least_squares.weights
        return weights, self.covariance.centre_features.T @ weights

    def leave_out(self, blocks: Sequence[slice]) -> LeftOut:
        """Predictions of each value from those outside its block.

        RW Eq. 5.12, for blocks, for the variance at the β of the others; with K⁻¹ − K⁻¹1 1ᵀK⁻¹ / 1ᵀK⁻¹1 for K⁻¹, as β
        is estimated without the block, too, for the mean and the variance of universal kriging.
        """
        solved = self.least_squares
        values = self.values
        mean, variance, kriging_variance = (np.full(len(values), empty) for empty in (np.nan, np.inf, np.inf))
        whitened = solve(solved.factor, np.eye(len(values)))
        basis = solved.basis / np.linalg.norm(solved.basis)
        without_basis = np.subtract(whitened, np.outer(basis, basis @ whitened), order="F")
        for block in blocks:
            if len(values[block]) < len(values):
                variance[block] = np.linalg.inv(whitened[:, block].T @ whitened[:, block]).diagonal()
                covariance = np.linalg.inv(without_basis[:, block].T @ without_basis[:, block])
                mean[block] = values[block] - covariance @ solved.weights[block]
                kriging_variance[block] = covariance.diagonal()
        signal = self.hyper_parameters.signal_std
        return LeftOut(mean, signal * np.sqrt(variance), signal * np.sqrt(kriging_variance))

    def _variances(self, query: Array) -> tuple[Array, Array]:
        whitened = self._whiten(query)
        basis = self.least_squares.basis
        from_constant = (1 - basis @ whitened) ** 2 / (basis @ basis)
        return self.covariance.prior_variance(query) - (whitened**2).sum(axis=0), from_constant

    def _half_variance_gradient(self, query: Array, *, kriging: bool) -> Array:
        covariance = self.covariance
        solved = self.least_squares
        whitened = self._whiten(query)
        if kriging:
            basis = solved.basis
            whitened = whitened + np.outer(basis, (1 - basis @ whitened) / (basis @ basis))
        weights = solve_transposed(solved.factor, whitened).T
        linear = covariance.linear_features(query) - weights @ covariance.centre_features
        return linear * covariance.slope_scale - covariance.cross_covariance_gradient(query, weights)

    def _whiten(self, query: Array) -> Array:
        """L⁻¹ (covariance of data and queries / signal²); shape (N, Q)."""
        covariance = self.covariance
        cross = covariance.cross_covariance(query) + covariance.linear_features(query) @ covariance.centre_features.T
        return solve(self.least_squares.factor, cross.T)


@final
@dataclass(frozen=True, eq=False)
class SparseGaussianProcess(GaussianProcess):
    """A Gaussian process that knows f at inducing points; created by `condition_sparse`.

    With the features φ = (L⁻¹k, linear features, 1) of a point, where k is its covariance with the inducing points and
    L Lᵀ that of these among each other, it is a linear regression on φ (RW Sec. 2.1) with the precision
    A = diag(1, …, 1, 0) + Σφφᵀ/ν, where ν is the variance of the noise [signal²]. A query costs M² instead of N².

    Attributes:
        inducing: Inducing points; shape (M, d).
    """

    inducing: Array

    @cached_property
    def inducing_factor(self) -> Array:
        """L, the Cholesky factor of the covariance of the inducing points / signal²; shape (M, M)."""
        correlation = self.covariance.correlation_of_centres()
        nothing = np.zeros((len(self.inducing), 0))
        return factorise(covariance_matrix(correlation, nothing, 0.0))

    @cached_property
    def weight_factor(self) -> Array:
        """Cholesky factor of A; shape (F, F) with F = M + d + 1."""
        features = self._features(self.points)
        precision = features @ features.T / self.hyper_parameters.noise_variance
        precision[np.diag_indices(len(precision) - 1)] += 1
        return factorise(np.ascontiguousarray(precision))

    @cached_property
    def weight_mean(self) -> Array:
        """A⁻¹ Σφ·value/ν, the expected weights of the features; shape (F,) [unit of the values]."""
        moment = self._features(self.points) @ self.values / self.hyper_parameters.noise_variance
        return solve_transposed(self.weight_factor, solve(self.weight_factor, moment))

    @property
    def coefficient(self) -> float:
        """β [unit of the values]."""
        return float(self.weight_mean[-1])

    @cached_property
    def weights(self) -> tuple[Array, Array]:
        """Weights in the mean: of the covariances with the inducing points (M,) and of the linear features (d,)."""
        size = len(self.inducing)
        return solve_transposed(self.inducing_factor, self.weight_mean[:size]), self.weight_mean[size:-1]

    def leave_out(self, blocks: Sequence[slice]) -> LeftOut:
        """Predictions of each value from those outside its block, at the same inducing points.

        With H = φᵀA⁻¹φ/ν of a block, its errors are (1 − H)⁻¹ times those with it, and the variance of its values, less
        that of f given the inducing points, is H (1 − H)⁻¹ ν = ((1 − H)⁻¹ − 1) ν.
        """
        noise = self.hyper_parameters.noise_variance
        count = len(self.values)
        features = self._features(self.points)
        whitened = solve(self.weight_factor, features)
        error = self.values - features.T @ self.weight_mean
        mean, growth, kriging_growth = (np.full(count, empty) for empty in (np.nan, np.inf, np.inf))
        for block in blocks:
            if len(self.values[block]) < count:
                inside = whitened[:, block]
                growth[block] = _left_out(inside[:-1], noise).diagonal()
                kriging = _left_out(inside, noise)
                kriging_growth[block] = kriging.diagonal()
                mean[block] = self.values[block] - kriging @ error[block]
        conditional = self._conditional_variance(features)
        variances = (conditional + noise * (factor - 1) for factor in (growth, kriging_growth))
        return LeftOut(mean, *(self.hyper_parameters.std(variance, include_noise=True) for variance in variances))

    def to_dict(self) -> dict[str, Any]:
        """What defines the process, for JSON; `process_from_dict` reads it."""
        return {"inducing": self.inducing.tolist(), **super().to_dict()}

    @property
    def _centres(self) -> Array:
        return self.inducing

    def _variances(self, query: Array) -> tuple[Array, Array]:
        features = self._features(query)
        # The last feature is the constant, which the factor eliminates last: without it, β is treated as exact.
        squares = solve(self.weight_factor, features) ** 2
        return self._conditional_variance(features) + squares[:-1].sum(axis=0), squares[-1]

    def _half_variance_gradient(self, query: Array, *, kriging: bool) -> Array:
        covariance = self.covariance
        size = len(self.inducing)
        features = self._features(query)
        whitened = solve(self.weight_factor, features)
        if not kriging:
            whitened[-1] = 0
        response = solve_transposed(self.weight_factor, whitened)
        weights = solve_transposed(self.inducing_factor, features[:size] - response[:size]).T
        linear = response[size:-1].T * covariance.slope_scale
        return linear - covariance.cross_covariance_gradient(query, weights)

    def _features(self, query: Array) -> Array:
        """φ of queries (Q, d); shape (F, Q)."""
        covariance = self.covariance
        whitened = solve(self.inducing_factor, covariance.cross_covariance(query).T)
        return np.concatenate([whitened, covariance.linear_features(query).T, np.ones((1, len(query)))])

    def _conditional_variance(self, features: Array) -> Array:
        """Variance of f given f at the inducing points [signal²]; shape (Q,)."""
        return np.maximum(1 - (features[: len(self.inducing)] ** 2).sum(axis=0), 0)


def condition(
    points: ArrayLike,
    values: ArrayLike,
    input_scale: ArrayLike,
    hyper_parameters: HyperParameters,
    kernel: Kernel = MATERN_52,
) -> ExactGaussianProcess:
    """Conditions a Gaussian process on the data, at fixed hyper-parameters.

    Args:
        points: Shape (N, d), N ≥ 1.
        values: Shape (N,).
        input_scale: Fixed size of each input, not taken from the data; shape (d,).
        hyper_parameters: Where `noise_std` is too small to distinguish the points in double
            precision, the least variance that suffices is added to the noise.
        kernel: Covariance of f.
    """
    points, values, input_scale = checked_data(points, values, input_scale, hyper_parameters)
    process = ExactGaussianProcess(points, values, input_scale, hyper_parameters, kernel)
    _ = process.weights  # data whose covariance is singular are refused here
    return process


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
    points, values, input_scale = checked_data(points, values, input_scale, hyper_parameters)
    noise_std = hyper_parameters.noise_std
    require(noise_std > 0, "noise_std", noise_std, "be positive for a sparse process")
    inducing = np.array(inducing, float)
    sized = inducing.ndim == 2 and len(inducing) > 0 and inducing.shape[1] == len(input_scale)
    require(sized, "inducing.shape", inducing.shape, f"be (M, {len(input_scale)}) with M ≥ 1")
    require(np.isfinite(inducing).all(), "inducing", inducing, "be finite")
    process = SparseGaussianProcess(points, values, input_scale, hyper_parameters, kernel, inducing)
    _ = process.weights  # as above
    return process


def process_from_dict(data: Mapping[str, Any], kernel: Kernel = MATERN_52) -> GaussianProcess:
    """Restores the process, exact or sparse, that `to_dict` saved.

    Raises:
        ValueError: A key is missing, its value is not finite numbers of the right size and sign, or the data are of
            another kernel.
    """
    name = data.get("kernel", kernel.name)  # which former versions did not write
    require(name == kernel.name, "kernel", name, f"be {kernel.name!r}")
    points = numbers(data, "points", 2)
    values = numbers(data, "values", 1)
    input_scale = numbers(data, "input_scale", 1)
    stds = (number(data, name) for name in ("signal_std", "noise_std", "slope_std"))
    hyper_parameters = HyperParameters(numbers(data, "length_scale", 1), *stds)
    if "inducing" not in data:
        rule = f"have at most {LARGEST_SAVED} rows without inducing points"
        require(len(points) <= LARGEST_SAVED, "points.shape", points.shape, rule)
        return condition(points, values, input_scale, hyper_parameters, kernel)
    inducing = numbers(data, "inducing", 2)
    rule = f"have at most {LARGEST_INDUCING} rows"
    require(len(inducing) <= LARGEST_INDUCING, "inducing.shape", inducing.shape, rule)
    return condition_sparse(points, values, input_scale, hyper_parameters, inducing, kernel)


def _left_out(whitened: Array, noise: float) -> Array:
    """(1 − H)⁻¹ for H = whitenedᵀ whitened / noise; shape (F, k) to (k, k)."""
    kept = np.eye(whitened.shape[1]) - whitened.T @ whitened / noise
    np.fill_diagonal(kept, np.maximum(kept.diagonal(), np.finfo(float).eps))
    return np.asarray(np.linalg.inv(kept), float)


def checked_data(
    points: ArrayLike, values: ArrayLike, input_scale: ArrayLike, hyper_parameters: HyperParameters | None = None
) -> tuple[Array, Array, Array]:
    """Copies of the data; raises ValueError, which names the argument, if a shape or a number is wrong."""
    points = np.array(points, float)
    values = np.array(values, float)
    input_scale = np.array(input_scale, float)
    require(input_scale.ndim == 1 and input_scale.size > 0, "input_scale.shape", input_scale.shape, "be (d,)")
    require(_positive(input_scale), "input_scale", input_scale, "be positive and finite")
    sized = points.ndim == 2 and len(points) > 0 and points.shape[1] == len(input_scale)
    require(sized, "points.shape", points.shape, f"be (N, {len(input_scale)}) with N ≥ 1")
    require(np.isfinite(points).all(), "points", points, "be finite")
    require(values.shape == points.shape[:1], "values.shape", values.shape, f"be ({len(points)},)")
    require(np.isfinite(values).all(), "values", values, "be finite")
    if hyper_parameters is not None:
        shape = hyper_parameters.length_scale.shape
        require(shape == input_scale.shape, "length_scale.shape", shape, f"be that of input_scale, {input_scale.shape}")
    return points, values, input_scale


def _positive(array: ArrayLike) -> bool:
    return bool(np.all(np.isfinite(array) & (np.asarray(array) > 0)))
