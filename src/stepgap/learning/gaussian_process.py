"""Gaussian process of one output: constant, slopes, radial Matérn-5/2 kernel, independent noise; one joint model.

The model: value = β + slopes · point + f(point) + noise. β may be anything, as in the paper's `fitrgp` call
(Sec. 6). A priori each slope, per `input_scale`, is N(0, slope_std²); with slope_std = 0 the model is that of
the paper. f has the covariance signal_std² k(r), k(r) = (1 + √5 r + 5r²/3) exp(−√5 r), where r is the distance
of two points measured in `input_scale · length_scale`, one length scale per input. Equations marked RW are
those of Rasmussen and Williams, Gaussian Processes for Machine Learning (2006).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import get_lapack_funcs
from scipy.spatial.distance import cdist, pdist

from stepgap.learning.cholesky import factorise, is_safe
from stepgap.learning.covariance import covariance_matrix, kernel, kernel_descent
from stepgap.learning.least_squares import LeastSquares, append_value, fit_least_squares
from stepgap.step import Array

KERNEL_BLOCK = 2**16
"""Kernel values computed at a time, so that a large batch of queries stays in the cache."""

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
        _require(_positive(self.length_scale), "length_scale", "positive and finite")
        _require(_positive(self.signal_std), "signal_std", "positive and finite")
        for name in ("noise_std", "slope_std"):
            std = getattr(self, name)
            _require(std == 0 or _positive(std), name, "non-negative and finite")


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
        weights = self.least_squares.weights

        def mean(query: Array) -> Array:
            return self.coefficient + kernel(self._distance(query)) @ weights + self._lean(query) @ self._rise

        return self._blockwise(mean, point)

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d) [unit of the values per unit of each input]."""
        weights = self.least_squares.weights
        slope = self._rise * self._steepness
        return self._blockwise(lambda query: self._kernel_gradient(query, weights) + slope, point)

    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Plug-in standard deviation, which takes β for exact (RW Eq. 2.26); shape (…) [unit of the values].

        Args:
            point: Shape (…, d).
            include_noise: False: of β + slopes · point + f. True: of a new noisy value, as MATLAB's `predict` gives it.
        """

        def variance(query: Array) -> Array:
            return self._prior(query) - (self._whiten(query) ** 2).sum(axis=0)

        return self._std(self._blockwise(variance, point), include_noise)

    def kriging_std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Universal-kriging standard deviation: as `std`, with β only estimated (RW Eq. 2.42); shape (…).

        Args:
            point: Shape (…, d).
            include_noise: False: of β + slopes · point + f. True: of a new noisy value.
        """
        return self._std(self._blockwise(self._kriging_variance, point), include_noise)

    def std_gradient(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """∂std/∂point; shape (…, d) [unit of the values per unit of each input]; see `kriging_std_gradient`."""
        half = self._blockwise(lambda query: self._half_variance_gradient(query, self._whiten(query)), point)
        return self._std_gradient(half, self.std(point, include_noise=include_noise))

    def kriging_std_gradient(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """∂kriging_std/∂point; shape (…, d) [unit of the values per unit of each input].

        Zero where the standard deviation is, at points known exactly, where it has a kink.

        Args:
            point: Shape (…, d).
            include_noise: As for `kriging_std`.
        """
        basis = self.least_squares.basis

        def gradient(query: Array) -> Array:
            whitened = self._whiten(query)
            surplus = (1 - basis @ whitened) / (basis @ basis)
            return self._half_variance_gradient(query, whitened + np.outer(basis, surplus))

        return self._std_gradient(
            self._blockwise(gradient, point), self.kriging_std(point, include_noise=include_noise)
        )

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
        hyper_parameters = HyperParameters(
            length_scale=_numbers(data, "length_scale", "a list of numbers", 1),
            signal_std=float(_numbers(data, "signal_std", "a number", 0)),
            noise_std=float(_numbers(data, "noise_std", "a number", 0)),
            slope_std=float(_numbers(data, "slope_std", "a number", 0)),
        )
        points = _numbers(data, "points", "a list of equally long lists of numbers", 2)
        values = _numbers(data, "values", "a list of numbers", 1)
        input_scale = _numbers(data, "input_scale", "a list of numbers", 1)
        return condition(points, values, input_scale, hyper_parameters)

    @cached_property
    def _reach(self) -> Array:
        """Length scales in the units of the points; shape (d,)."""
        return self.input_scale * self.hyper_parameters.length_scale

    @cached_property
    def _data(self) -> Array:
        """Points in length scales; shape (N, d)."""
        return self.points / self._reach

    @cached_property
    def _steepness(self) -> Array:
        """Slopes of one standard deviation, in signals per unit of each input; shape (d,)."""
        return self.hyper_parameters.slope_std / self.hyper_parameters.signal_std / self.input_scale

    @cached_property
    def _data_lean(self) -> Array:
        """`_lean` of the data; shape (N, d)."""
        return self._lean(self.points)

    @cached_property
    def _rise(self) -> Array:
        """Expected slopes, in standard deviations, times the signal; shape (d,)."""
        return self._data_lean.T @ self.least_squares.weights

    def _lean(self, query: Array) -> Array:
        """What slopes of one standard deviation add between the first point and queries [signals]; shape (Q, d)."""
        return (query - self.points[0]) * self._steepness

    def _distance(self, query: Array) -> Array:
        """√5 r between queries (Q, d) and the data; shape (Q, N)."""
        return np.sqrt(5 * cdist(query / self._reach, self._data, "sqeuclidean"))

    def _prior(self, query: Array) -> Array:
        """Variance without data, of all but β [signal²]; shape (Q,)."""
        return 1 + (self._lean(query) ** 2).sum(axis=1)

    def _whiten(self, query: Array) -> Array:
        """factor⁻¹ (covariance of data and queries / signal²); shape (N, Q)."""
        covariance = kernel(self._distance(query)) + self._lean(query) @ self._data_lean.T
        return self.least_squares.factor.solve(covariance.T)

    def _kriging_variance(self, query: Array) -> Array:
        """Variance of universal kriging [signal²]; shape (Q,)."""
        whitened, basis = self._whiten(query), self.least_squares.basis
        return self._prior(query) - (whitened**2).sum(axis=0) + (1 - basis @ whitened) ** 2 / (basis @ basis)

    def _half_variance_gradient(self, query: Array, whitened: Array) -> Array:
        """½ ∂variance/∂query [signal²], given factorᵀ times the weights that values have (N, Q); shape (Q, d)."""
        weights = self.least_squares.factor.solve_transposed(whitened).T
        lean = self._lean(query) - weights @ self._data_lean
        return lean * self._steepness - self._kernel_gradient(query, weights)

    def _std_gradient(self, half: Array, std: Array) -> Array:
        """∂std/∂point (…, d), given ½ ∂variance/∂point [signal²] (…, d) and the standard deviation (…)."""
        half, std = self.hyper_parameters.signal_std**2 * half, std[..., None]
        return np.divide(half, std, out=np.zeros_like(half), where=std != 0)

    def _kernel_gradient(self, query: Array, weights: Array) -> Array:
        """∂(k @ weights)/∂query for weights (N,) or (Q, N); shape (Q, d)."""
        pull = kernel_descent(self._distance(query)) * weights
        return (pull @ self._data - pull.sum(axis=1, keepdims=True) * (query / self._reach)) / self._reach

    def _std(self, variance: Array, include_noise: bool) -> Array:
        """Standard deviation that belongs to a variance [signal²]."""
        # Rounding can leave a variance slightly below zero at a point that was observed.
        std = self.hyper_parameters.signal_std * np.sqrt(np.maximum(variance, 0))
        return np.hypot(std, self.hyper_parameters.noise_std) if include_noise else std

    def _blockwise(self, evaluate: Callable[[Array], Array], point: ArrayLike) -> Array:
        """Apply `evaluate` to blocks (Q, d) of queries; shape (…) or (…, d)."""
        point = np.asarray(point, float)
        query = np.where(np.isfinite(point), point, np.nan).reshape(-1, len(self._reach))
        rows = max(1, KERNEL_BLOCK // len(self.values))
        blocks = [evaluate(query[start : start + rows]) for start in range(0, max(1, len(query)), rows)]
        result = np.concatenate(blocks) if len(blocks) > 1 else blocks[0]
        return result.reshape(point.shape[:-1] + result.shape[1:])


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
    length_scale, signal = hyper_parameters.length_scale, hyper_parameters.signal_std
    _require(
        length_scale.shape == input_scale.shape, "length_scale", f"as many numbers as input_scale ({points.shape[1]})"
    )
    distance = np.sqrt(5 * pdist(points / (input_scale * length_scale), "sqeuclidean"))
    lean = (points - points[0]) * (hyper_parameters.slope_std / signal / input_scale)
    matrix = covariance_matrix(kernel(distance), lean, (hyper_parameters.noise_std / signal) ** 2)
    least_squares = fit_least_squares(factorise(matrix), values)
    return GaussianProcess(points, values, input_scale, hyper_parameters, least_squares)


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
    prior = process._prior(points[[-1]])
    noise = (hyper_parameters.noise_std / hyper_parameters.signal_std) ** 2 + solved.factor.jitter
    squared_pivot = float(prior[0] + noise - row @ row)
    if not is_safe(squared_pivot, np.append(process._prior(process.points), prior)):
        return condition(points, values, process.input_scale, hyper_parameters)
    least_squares = append_value(solved, row, math.sqrt(squared_pivot), float(value_[0]))
    return GaussianProcess(points, values, process.input_scale, hyper_parameters, least_squares)


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


def checked_data(points: ArrayLike, values: ArrayLike, input_scale: ArrayLike) -> tuple[Array, Array, Array]:
    """Own copies of the data, once their shapes and numbers are sound."""
    points, values, input_scale = np.array(points, float), np.array(values, float), np.array(input_scale, float)
    _require(input_scale.ndim == 1 and input_scale.size > 0, "input_scale", "of shape (d,)")
    _require(_positive(input_scale), "input_scale", "positive and finite")
    sized = points.ndim == 2 and len(points) > 0 and points.shape[1] == len(input_scale)
    _require(sized, "points", f"of shape (N, {len(input_scale)}) with N ≥ 1, not {points.shape}")
    _require(np.isfinite(points).all(), "points", "finite")
    _require(values.shape == points.shape[:1], "values", f"of shape ({len(points)},), not {values.shape}")
    _require(np.isfinite(values).all(), "values", "finite")
    return points, values, input_scale


def _numbers(data: Mapping[str, Any], key: str, what: str, dimensions: int) -> Array:
    """The array of numbers saved under `key`."""
    _require(key in data, key, f"{what}, but it is missing")
    try:
        array = np.asarray(data[key])
    except ValueError as ragged:
        raise ValueError(f"{key} must be {what}") from ragged
    _require(array.dtype.kind in "if" and array.ndim == dimensions, key, what)
    return array.astype(float)


def _positive(array: ArrayLike) -> bool:
    return bool(np.all(np.isfinite(array) & (np.asarray(array) > 0)))


def _require(holds: object, name: str, what: str) -> None:
    if not holds:
        raise ValueError(f"{name} must be {what}")
