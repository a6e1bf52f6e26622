"""Gaussian process of one output: constant, slopes, radial Matérn-5/2 kernel, independent noise; one joint model.

The model: value = β + slopes · point + f(point) + noise. β may be anything, as in the paper's `fitrgp` call
(Sec. 6). A priori each slope, per `input_scale`, is N(0, slope_std²); with slope_std = 0 the model is that of
the paper. f has the covariance signal_std² k(r), k(r) = (1 + √5 r + 5r²/3) exp(−√5 r), where r is the distance
of two points measured in `input_scale · length_scale`, one length scale per input. Equations marked RW are
those of Rasmussen and Williams, Gaussian Processes for Machine Learning (2006).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, singledispatch
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import get_lapack_funcs
from scipy.spatial.distance import pdist

from stepgap.learning.cholesky import factorise, is_safe
from stepgap.learning.covariance import Covariance, covariance_matrix, kernel
from stepgap.learning.least_squares import LeastSquares, append_value, fit_least_squares
from stepgap.learning.saved import numbers
from stepgap.step import Array

(_potri,) = get_lapack_funcs(("potri",), dtype=np.float64)


@final
@dataclass(frozen=True, eq=False)
class HyperParameters:
    """What a fit chooses; see `gaussian_process_fit`.

    Attributes:
        length_scale: Distance over which f changes, in input scales; shape (d,).
        signal_std: Standard deviation of f [unit of the values].
        noise_std: Standard deviation of the noise of one value [unit of the values].
        slope_std: Standard deviation of each slope a priori [unit of the values per input scale].
    """

    length_scale: Array
    signal_std: float
    noise_std: float
    slope_std: float = 0.0

    def __post_init__(self) -> None:
        require(_positive(self.length_scale), "length_scale", "positive and finite")
        require(_positive(self.signal_std), "signal_std", "positive and finite")
        for name in ("noise_std", "slope_std"):
            std = getattr(self, name)
            require(std == 0 or _positive(std), name, "non-negative and finite")

    def covariance(self, centres: Array, origin: Array, input_scale: Array) -> Covariance:
        """Covariance with fixed centres (M, d)."""
        return Covariance(
            centres, origin, input_scale * self.length_scale, self.slope_std / self.signal_std / input_scale
        )

    def std(self, variance: Array, include_noise: bool) -> Array:
        """Standard deviation that belongs to a variance [signal²], without or with the noise."""
        # Rounding can leave a variance slightly below zero at a point that was observed.
        std = self.signal_std * np.sqrt(np.maximum(variance, 0))
        return np.hypot(std, self.noise_std) if include_noise else std

    def std_gradient(self, half_variance_gradient: Array, std: Array) -> Array:
        """∂std/∂point, given ½ ∂variance/∂point [signal²] (…, d) and `std` (…)."""
        half = self.signal_std**2 * half_variance_gradient
        return np.divide(half, std[..., None], out=np.zeros_like(half), where=std[..., None] != 0)


@final
@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """A Gaussian process conditioned on data; made by `condition`, or by a fit of `gaussian_process_fit`.

    Queries have shape (…, d) and the units of `points`; one that is not finite gives NaN.

    Attributes:
        points: Inputs; shape (N, d). Slopes turn about the first; with a free β any other place would do.
        values: Outputs; shape (N,).
        input_scale: Fixed size of each input, in which its length scale is measured; shape (d,).
        hyper_parameters: Length scales, signal, noise and slopes.
        least_squares: β and the weights of the data at these hyper-parameters.
    """

    points: Array
    values: Array
    input_scale: Array
    hyper_parameters: HyperParameters
    least_squares: LeastSquares

    @property
    def coefficient(self) -> float:
        """β: without slopes, the mean far from all data [unit of the values]."""
        return self.least_squares.coefficient

    @property
    def log_likelihood(self) -> float:
        """Logarithm of p(values) at these hyper-parameters and this β (RW Eq. 2.30)."""
        return self.least_squares.log_likelihood(self.hyper_parameters.signal_std)

    def mean(self, point: ArrayLike) -> Array:
        """Expected value; shape (…) [unit of the values] (RW Eq. 2.38)."""
        covariance, weights = self._covariance, self.least_squares.weights

        def mean(query: Array) -> Array:
            return self.coefficient + covariance.kernel(query) @ weights + covariance.lean(query) @ self._rise

        return covariance.blockwise(mean, point)

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d) [unit of the values per unit of each input]."""
        covariance, weights = self._covariance, self.least_squares.weights
        slope = self._rise * covariance.steepness
        return covariance.blockwise(lambda query: covariance.kernel_gradient(query, weights) + slope, point)

    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Plug-in standard deviation, which takes β for exact (RW Eq. 2.26); shape (…) [unit of the values].

        Args:
            point: Shape (…, d).
            include_noise: False: of β + slopes · point + f. True: of a new noisy value, as MATLAB's `predict` gives it.
        """

        def variance(query: Array) -> Array:
            return self._covariance.prior(query) - (self._whiten(query) ** 2).sum(axis=0)

        return self.hyper_parameters.std(self._covariance.blockwise(variance, point), include_noise)

    def kriging_std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Universal-kriging standard deviation: as `std`, with β only estimated (RW Eq. 2.42); shape (…).

        Args:
            point: Shape (…, d).
            include_noise: False: of β + slopes · point + f. True: of a new noisy value.
        """
        variance = self._covariance.blockwise(self._kriging_variance, point)
        return self.hyper_parameters.std(variance, include_noise)

    def std_gradient(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """∂std/∂point; shape (…, d) [unit of the values per unit of each input]; see `kriging_std_gradient`."""

        def half_variance_gradient(query: Array) -> Array:
            return self._half_variance_gradient(query, self._whiten(query))

        half = self._covariance.blockwise(half_variance_gradient, point)
        return self.hyper_parameters.std_gradient(half, self.std(point, include_noise=include_noise))

    def kriging_std_gradient(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """∂kriging_std/∂point; shape (…, d) [unit of the values per unit of each input].

        Zero where the standard deviation is, at points known exactly, where it has a kink.

        Args:
            point: Shape (…, d).
            include_noise: As for `kriging_std`.
        """
        basis = self.least_squares.basis

        def half_variance_gradient(query: Array) -> Array:
            whitened = self._whiten(query)
            surplus = (1 - basis @ whitened) / (basis @ basis)
            return self._half_variance_gradient(query, whitened + np.outer(basis, surplus))

        half = self._covariance.blockwise(half_variance_gradient, point)
        return self.hyper_parameters.std_gradient(half, self.kriging_std(point, include_noise=include_noise))

    def to_dict(self) -> dict[str, Any]:
        """Data and hyper-parameters as JSON-ready numbers; everything else follows from them."""
        return {
            "input_scale": self.input_scale.tolist(),
            "points": self.points.tolist(),
            "values": self.values.tolist(),
            "length_scale": self.hyper_parameters.length_scale.tolist(),
            "signal_std": self.hyper_parameters.signal_std,
            "noise_std": self.hyper_parameters.noise_std,
            "slope_std": self.hyper_parameters.slope_std,
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "GaussianProcess":
        """The process that `to_dict` saved.

        Raises:
            ValueError: A key is missing, or holds anything but finite numbers of the right size and sign.
        """
        hyper_parameters = saved_hyper_parameters(data)
        points = numbers(data, "points", 2)
        values = numbers(data, "values", 1)
        input_scale = numbers(data, "input_scale", 1)
        return condition(points, values, input_scale, hyper_parameters)

    @cached_property
    def _covariance(self) -> Covariance:
        """Of queries and the data."""
        return self.hyper_parameters.covariance(self.points, self.points[0], self.input_scale)

    @cached_property
    def _rise(self) -> Array:
        """Expected slopes, in standard deviations, times the signal; shape (d,)."""
        return self._covariance.centre_lean.T @ self.least_squares.weights

    def _whiten(self, query: Array) -> Array:
        """factor⁻¹ (covariance of data and queries / signal²); shape (N, Q)."""
        covariance = self._covariance
        between = covariance.kernel(query) + covariance.lean(query) @ covariance.centre_lean.T
        return self.least_squares.factor.solve(between.T)

    def _kriging_variance(self, query: Array) -> Array:
        """Variance of universal kriging [signal²]; shape (Q,)."""
        whitened, basis = self._whiten(query), self.least_squares.basis
        surplus = (1 - basis @ whitened) ** 2 / (basis @ basis)
        return self._covariance.prior(query) - (whitened**2).sum(axis=0) + surplus

    def _half_variance_gradient(self, query: Array, whitened: Array) -> Array:
        """½ ∂variance/∂query [signal²], given factorᵀ times the weights that values have (N, Q); shape (Q, d)."""
        covariance, weights = self._covariance, self.least_squares.factor.solve_transposed(whitened).T
        lean = covariance.lean(query) - weights @ covariance.centre_lean
        return lean * covariance.steepness - covariance.kernel_gradient(query, weights)


def condition(
    points: ArrayLike, values: ArrayLike, input_scale: ArrayLike, hyper_parameters: HyperParameters
) -> GaussianProcess:
    """Gaussian process given the data, at fixed hyper-parameters.

    Args:
        points: Shape (N, d), N ≥ 1.
        values: Shape (N,).
        input_scale: Fixed size of each input, not taken from the data; shape (d,).
        hyper_parameters: Where `noise_std` is too small for the points to be told apart in double
            precision, the least variance that suffices is added to the noise.
    """
    points, values, input_scale = checked_data(points, values, input_scale)
    check_sizes(hyper_parameters, input_scale)
    covariance = hyper_parameters.covariance(points, points[0], input_scale)
    distance = np.sqrt(5 * pdist(points / covariance.reach, "sqeuclidean"))
    noise = (hyper_parameters.noise_std / hyper_parameters.signal_std) ** 2
    matrix = covariance_matrix(kernel(distance), covariance.centre_lean, noise)
    least_squares = fit_least_squares(factorise(matrix), values)
    return GaussianProcess(points, values, input_scale, hyper_parameters, least_squares)


@singledispatch
def append(process: GaussianProcess, point: ArrayLike, value: float) -> GaussianProcess:
    """Gaussian process given one point more, at the same hyper-parameters, in O(N²).

    The same as `condition` on all data but for rounding; a point that can hardly be told apart from the others
    leads to exactly that. `process` stays as it is.

    Args:
        process: Conditioned on the other points.
        point: Shape (d,).
        value: Output there.
    """
    hyper_parameters, solved = process.hyper_parameters, process.least_squares
    new, value_, _ = checked_data(np.asarray(point, float)[None], np.asarray([value]), process.input_scale)
    points, values = np.concatenate([process.points, new]), np.concatenate([process.values, value_])
    row = process._whiten(new)[:, 0]
    prior = process._covariance.prior(points)
    noise = (hyper_parameters.noise_std / hyper_parameters.signal_std) ** 2 + solved.factor.jitter
    squared_pivot = float(prior[-1] + noise - row @ row)
    if not is_safe(squared_pivot, prior):
        return condition(points, values, process.input_scale, hyper_parameters)
    least_squares = append_value(solved, row, math.sqrt(squared_pivot), float(value_[0]))
    return GaussianProcess(points, values, process.input_scale, hyper_parameters, least_squares)


@singledispatch
def leave_one_out(process: GaussianProcess) -> tuple[Array, Array]:
    """What the process would predict of each value, had it not seen that value, at the same hyper-parameters.

    With the estimated β as part of the prediction (RW Eq. 5.12, with C⁻¹ − C⁻¹1 1ᵀC⁻¹ / 1ᵀC⁻¹1 for K⁻¹). Of a
    single value nothing is left to predict from: then the mean is NaN and the standard deviation infinite.

    Returns:
        Means and standard deviations of the noisy values, which `kriging_std(…, include_noise=True)` would give;
        shapes (N,) and (N,) [unit of the values].
    """
    solved = process.least_squares
    if len(process.values) == 1:
        return np.array([np.nan]), np.array([np.inf])
    inverse, _ = _potri(solved.factor.whole(), lower=1)
    by_ones = solved.factor.solve_transposed(solved.basis)
    precision = inverse.diagonal() - by_ones**2 / by_ones.sum()
    return process.values - solved.weights / precision, process.hyper_parameters.signal_std / np.sqrt(precision)


@singledispatch
def leave_out(process: GaussianProcess, blocks: Sequence[slice]) -> tuple[Array, Array]:
    """As `leave_one_out`, but each value is predicted from those outside its block.

    Args:
        process: Conditioned on all values.
        blocks: Consecutive parts of the values; one that holds them all leaves nothing to predict from.
    """
    solved, values = process.least_squares, process.values
    mean, variance = np.full(len(values), np.nan), np.full(len(values), np.inf)
    whitened = solved.factor.solve(np.eye(len(values)))
    basis = solved.basis / np.linalg.norm(solved.basis)
    whitened -= np.outer(basis, basis @ whitened)
    for block in blocks:
        if len(values[block]) < len(values):
            covariance = np.linalg.inv(whitened[:, block].T @ whitened[:, block])
            mean[block] = values[block] - covariance @ solved.weights[block]
            variance[block] = covariance.diagonal()
    return mean, process.hyper_parameters.signal_std * np.sqrt(variance)


def checked_data(points: ArrayLike, values: ArrayLike, input_scale: ArrayLike) -> tuple[Array, Array, Array]:
    """Own copies of the data, once their shapes and numbers are sound."""
    points, values, input_scale = np.array(points, float), np.array(values, float), np.array(input_scale, float)
    require(input_scale.ndim == 1 and input_scale.size > 0, "input_scale", "of shape (d,)")
    require(_positive(input_scale), "input_scale", "positive and finite")
    sized = points.ndim == 2 and len(points) > 0 and points.shape[1] == len(input_scale)
    require(sized, "points", f"of shape (N, {len(input_scale)}) with N ≥ 1, not {points.shape}")
    require(np.isfinite(points).all(), "points", "finite")
    require(values.shape == points.shape[:1], "values", f"of shape ({len(points)},), not {values.shape}")
    require(np.isfinite(values).all(), "values", "finite")
    return points, values, input_scale


def check_sizes(hyper_parameters: HyperParameters, input_scale: Array) -> None:
    """Raises ValueError unless there is a length scale for each input."""
    same = hyper_parameters.length_scale.shape == input_scale.shape
    require(same, "length_scale", f"as many numbers as input_scale ({len(input_scale)})")


def saved_hyper_parameters(data: Mapping[str, Any]) -> HyperParameters:
    """Those of a process that was saved; raises ValueError as `GaussianProcess.from_dict` does."""
    length_scale = numbers(data, "length_scale", 1)
    stds = (float(numbers(data, name, 0)) for name in ("signal_std", "noise_std", "slope_std"))
    return HyperParameters(length_scale, *stds)


def _positive(array: ArrayLike) -> bool:
    return bool(np.all(np.isfinite(array) & (np.asarray(array) > 0)))


def require(holds: object, name: str, what: str) -> None:
    """Raises ValueError, which says what `name` must be, unless it holds."""
    if not holds:
        raise ValueError(f"{name} must be {what}")
