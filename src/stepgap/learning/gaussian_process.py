"""Gaussian process of one output: constant basis, radial Matérn-5/2 kernel, independent noise.

The model of the paper's `fitrgp` call (Sec. 6): value = β + f(point) + noise, where f has covariance
signal_std² k(r), k(r) = (1 + √5 r + 5r²/3) exp(−√5 r), and r is the distance of two points measured in
`input_scale · length_scale`, one length scale per input. Equations marked RW are those of Rasmussen
and Williams, Gaussian Processes for Machine Learning (2006).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import get_lapack_funcs
from scipy.spatial.distance import cdist, pdist, squareform

from stepgap.step import Array

KERNEL_BLOCK = 2**16
"""Kernel values computed at a time, so that a large batch of queries stays in the cache."""

_potrf, _trtrs = get_lapack_funcs(("potrf", "trtrs"), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class HyperParameters:
    """What a fit chooses; see `gaussian_process_fit`.

    Attributes:
        length_scale: Distance over which f changes, in input scales; shape (d,).
        signal_std: Standard deviation of f around the constant basis [unit of the values].
        noise_std: Standard deviation of the noise of one value [unit of the values].
    """

    length_scale: Array
    signal_std: float
    noise_std: float

    def __post_init__(self) -> None:
        _require(_positive(self.length_scale), "length_scale", "positive and finite")
        _require(_positive(self.signal_std), "signal_std", "positive and finite")
        _require(self.noise_std == 0 or _positive(self.noise_std), "noise_std", "non-negative and finite")


class LeastSquares(NamedTuple):
    """The constant basis fitted by generalised least squares, in units of the signal.

    Attributes:
        factor: Lower Cholesky factor of C = covariance of the values / signal_std², Fortran-contiguous; shape (N, N).
        basis: factor⁻¹ 1; shape (N,).
        coefficient: β = 1ᵀC⁻¹ values / 1ᵀC⁻¹1 [unit of the values].
        weights: C⁻¹ (values − β); shape (N,).
        misfit: (values − β)ᵀ C⁻¹ (values − β).
    """

    factor: Array
    basis: Array
    coefficient: float
    weights: Array
    misfit: float

    def log_likelihood(self, signal: float) -> float:
        """Logarithm of p(values), for a standard deviation of the signal, at this β (RW Eq. 2.30)."""
        half_log_determinant = np.log(self.factor.diagonal()).sum() + len(self.weights) * math.log(signal)
        constant = 0.5 * len(self.weights) * math.log(2 * math.pi)
        return float(-0.5 * self.misfit / signal**2 - half_log_determinant - constant)


@final
@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """A Gaussian process conditioned on data; made by `condition`, or by a fit of `gaussian_process_fit`.

    Queries have shape (…, d) and the units of `points`; one that is not finite gives NaN.

    Attributes:
        points: Inputs; shape (N, d).
        values: Outputs; shape (N,).
        input_scale: Fixed size of each input, in which its length scale is measured; shape (d,).
        hyper_parameters: Length scales, signal and noise.
        least_squares: The constant basis and the weights of the data at these hyper-parameters.
    """

    points: Array
    values: Array
    input_scale: Array
    hyper_parameters: HyperParameters
    least_squares: LeastSquares

    @property
    def coefficient(self) -> float:
        """β, the mean far from all data [unit of the values]."""
        return self.least_squares.coefficient

    @property
    def log_likelihood(self) -> float:
        """Logarithm of p(values) at these hyper-parameters and this β (RW Eq. 2.30)."""
        return self.least_squares.log_likelihood(self.hyper_parameters.signal_std)

    def mean(self, point: ArrayLike) -> Array:
        """Expected value; shape (…) [unit of the values] (RW Eq. 2.38)."""
        weights = self.least_squares.weights
        return self._blockwise(lambda query: self.coefficient + _kernel(self._distance(query)) @ weights, point)

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d) [unit of the values per unit of each input]."""

        def gradient(query: Array) -> Array:
            pull = kernel_descent(self._distance(query)) * self.least_squares.weights
            return (pull @ self._data - pull.sum(axis=1, keepdims=True) * query) / self._reach

        return self._blockwise(gradient, point)

    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Plug-in standard deviation, which takes β for exact (RW Eq. 2.26); shape (…) [unit of the values].

        Args:
            point: Shape (…, d).
            include_noise: False: of β + f. True: of a new noisy value, as MATLAB's `predict` gives it.
        """
        return self._std(lambda whitened: 1 - (whitened**2).sum(axis=0), point, include_noise)

    def kriging_std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Universal-kriging standard deviation: as `std`, with β only estimated (RW Eq. 2.42); shape (…).

        Args:
            point: Shape (…, d).
            include_noise: False: of β + f. True: of a new noisy value.
        """
        basis = self.least_squares.basis

        def variance(whitened: Array) -> Array:
            return 1 - (whitened**2).sum(axis=0) + (1 - basis @ whitened) ** 2 / (basis @ basis)

        return self._std(variance, point, include_noise)

    def to_dict(self) -> dict[str, Any]:
        """Data and hyper-parameters as JSON-ready numbers; everything else follows from them."""
        return {
            "input_scale": self.input_scale.tolist(),
            "points": self.points.tolist(),
            "values": self.values.tolist(),
            "length_scale": self.hyper_parameters.length_scale.tolist(),
            "signal_std": self.hyper_parameters.signal_std,
            "noise_std": self.hyper_parameters.noise_std,
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

    def _distance(self, query: Array) -> Array:
        """√5 r between queries in length scales (Q, d) and the data; shape (Q, N)."""
        return np.sqrt(5 * cdist(query, self._data, "sqeuclidean"))

    def _std(self, variance: Callable[[Array], Array], point: ArrayLike, include_noise: bool) -> Array:
        """Standard deviation, given the variance (Q,) that belongs to factor⁻¹ k (N, Q)."""

        def latent(query: Array) -> Array:
            whitened, _ = _trtrs(self.least_squares.factor, _kernel(self._distance(query)).T, lower=1)
            return variance(whitened)

        # Rounding can leave a variance slightly below zero at a point that was observed.
        std = self.hyper_parameters.signal_std * np.sqrt(np.maximum(self._blockwise(latent, point), 0))
        return np.hypot(std, self.hyper_parameters.noise_std) if include_noise else std

    def _blockwise(self, evaluate: Callable[[Array], Array], point: ArrayLike) -> Array:
        """Apply `evaluate` to blocks (Q, d) of queries in length scales; shape (…) or (…, d)."""
        point = np.asarray(point, float)
        query = np.where(np.isfinite(point), point, np.nan).reshape(-1, len(self._reach)) / self._reach
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
    least_squares = least_squares_fit(distance, hyper_parameters.noise_std / signal, values)
    return GaussianProcess(points, values, input_scale, hyper_parameters, least_squares)


def least_squares_fit(distance: Array, ratio: float, values: Array) -> LeastSquares:
    """Fit the basis, given √5 r of every pair of points (N(N−1)/2,) and noise over signal."""
    factor = _factorise(_kernel(distance), ratio**2, len(values))
    whitened, _ = _trtrs(factor, np.stack([np.ones(len(values)), values]).T, lower=1)
    basis, whitened_values = whitened.T
    coefficient = float(basis @ whitened_values / (basis @ basis))
    innovation = whitened_values - coefficient * basis
    weights, _ = _trtrs(factor, innovation, lower=1, trans=1)
    return LeastSquares(factor, basis, coefficient, weights, float(innovation @ innovation))


def _factorise(correlation: Array, noise: float, size: int) -> Array:
    """Lower Cholesky factor (N, N) of what has `correlation` (N(N−1)/2,) off its diagonal, 1 + noise on it."""
    covariance = squareform(correlation, checks=False)
    for jitter in (0.0, 1e-12, 1e-10, 1e-8):
        np.fill_diagonal(covariance, 1 + noise + jitter)
        factor, failed = _potrf(covariance.T, lower=1)
        if not failed and factor.diagonal().min() ** 2 > size * np.finfo(float).eps:
            return factor
    raise np.linalg.LinAlgError(f"the covariance of {size} points is singular")


def _kernel(distance: Array) -> Array:
    """Matérn-5/2, k as a function of √5 r (RW Eq. 4.17)."""
    return (1 + distance + distance**2 / 3) * np.exp(-distance)


def kernel_descent(distance: Array) -> Array:
    """−(dk/dr) / r as a function of √5 r; finite where two points meet."""
    return 5 / 3 * (1 + distance) * np.exp(-distance)


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
