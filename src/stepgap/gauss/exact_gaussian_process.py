"""The Gaussian process conditioned on all data without approximation, by a Cholesky factor that grows with them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import get_lapack_funcs

from stepgap.base.ranges import require
from stepgap.gauss.cholesky import factorise, is_safe
from stepgap.gauss.covariance import covariance_matrix
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
from stepgap.gauss.kernel import MATERN_52, Kernel
from stepgap.gauss.least_squares import LeastSquares, append_value, fit_least_squares
from stepgap.step import Array

LARGEST_SAVED = 6000
"""Largest number of points of a saved process that is read; the memory grows with its square."""

(_potri,) = get_lapack_funcs(("potri",), dtype=np.float64)


@final
@dataclass(frozen=True, eq=False)
class ExactGaussianProcess(GaussianProcess):
    """A Gaussian process conditioned on data; created by `condition`, or by a fit of `gaussian_process_fit`.

    Attributes:
        least_squares: β and the weights of the data at these hyper-parameters.
    """

    least_squares: LeastSquares

    @property
    def coefficient(self) -> float:
        """β by generalised least squares [unit of the values]."""
        return self.least_squares.coefficient

    def append(self, point: ArrayLike, value: float) -> "ExactGaussianProcess":
        """Conditions the process on one more point (d,) and value, at the same hyper-parameters, in O(N²).

        The result is that of `condition` on all data, up to rounding; a point that can hardly be distinguished from
        the others is added by `condition` itself.
        """
        hyper_parameters, solved = self.hyper_parameters, self.least_squares
        new_point, new_value, _ = checked_data(np.asarray(point, float)[None], np.asarray([value]), self.input_scale)
        points, values = np.concatenate([self.points, new_point]), np.concatenate([self.values, new_value])
        row = self._whiten(new_point)[:, 0]
        prior = self.covariance.prior_variance(points)
        noise = hyper_parameters.noise_variance + solved.factor.jitter
        squared_pivot = float(prior[-1] + noise - row @ row)
        if not is_safe(squared_pivot, prior):
            return condition(points, values, self.input_scale, hyper_parameters, self.kernel)
        least_squares = append_value(solved, row, math.sqrt(squared_pivot), float(new_value[0]))
        return ExactGaussianProcess(points, values, self.input_scale, hyper_parameters, self.kernel, least_squares)

    def leave_one_out(self) -> LeftOut:
        """Leave-one-out predictions; for a single value the mean is NaN and the standard deviation infinite.

        RW Eq. 5.12 for the variance at the β of the others; with K⁻¹ − K⁻¹1 1ᵀK⁻¹ / 1ᵀK⁻¹1 for K⁻¹, as β is estimated
        without the value, too, for the mean and the variance of universal kriging.
        """
        solved, signal = self.least_squares, self.hyper_parameters.signal_std
        if len(self.values) == 1:
            return LeftOut(np.array([np.nan]), np.array([np.inf]), np.array([np.inf]))
        K_inv, _ = _potri(solved.factor.assembled(), lower=1)
        K_inv_1 = solved.factor.solve_transposed(solved.basis)
        precision = K_inv.diagonal() - K_inv_1**2 / K_inv_1.sum()
        mean = self.values - solved.weights / precision
        return LeftOut(mean, signal / np.sqrt(K_inv.diagonal()), signal / np.sqrt(precision))

    def leave_out(self, blocks: Sequence[slice]) -> LeftOut:
        """Leave-block-out predictions: as `leave_one_out`, for blocks of values."""
        solved, values = self.least_squares, self.values
        mean, variance, kriging_variance = (np.full(len(values), each) for each in (np.nan, np.inf, np.inf))
        whitened = solved.factor.solve(np.eye(len(values)))
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

    @staticmethod
    def from_dict(data: Mapping[str, Any], kernel: Kernel = MATERN_52) -> "ExactGaussianProcess":
        """Restores the process that `to_dict` saved.

        Raises:
            ValueError: A key is missing, its value is not finite numbers of the right size and sign, or the data are
                of another kernel.
        """
        check_kernel(data, kernel)
        points, values, input_scale = saved_data(data)
        rule = f"have at most {LARGEST_SAVED} rows without inducing points"
        require(len(points) <= LARGEST_SAVED, "points.shape", points.shape, rule)
        return condition(points, values, input_scale, saved_hyper_parameters(data), kernel)

    def _solve_weights(self) -> tuple[Array, Array]:
        weights = self.least_squares.weights
        return weights, self.covariance.centre_features.T @ weights

    def _variance(self, query: Array) -> Array:
        return self.covariance.prior_variance(query) - (self._whiten(query) ** 2).sum(axis=0)

    def _kriging_variance(self, query: Array) -> Array:
        whitened, basis = self._whiten(query), self.least_squares.basis
        from_constant = (1 - basis @ whitened) ** 2 / (basis @ basis)  # variance due to the uncertainty of β
        return self.covariance.prior_variance(query) - (whitened**2).sum(axis=0) + from_constant

    def _half_variance_gradient(self, query: Array) -> Array:
        return self._gradient_of(query, self._whiten(query))

    def _half_kriging_variance_gradient(self, query: Array) -> Array:
        whitened, basis = self._whiten(query), self.least_squares.basis
        from_constant = (1 - basis @ whitened) / (basis @ basis)
        return self._gradient_of(query, whitened + np.outer(basis, from_constant))

    def _whiten(self, query: Array) -> Array:
        """Computes factor⁻¹ (covariance of data and queries / signal²); shape (N, Q)."""
        covariance = self.covariance
        cross = covariance.cross_covariance(query) + covariance.linear_features(query) @ covariance.centre_features.T
        return self.least_squares.factor.solve(cross.T)

    def _gradient_of(self, query: Array, whitened: Array) -> Array:
        """½ ∂variance/∂query [signal²], given factorᵀ times the weights of the values (N, Q); shape (Q, d)."""
        covariance, weights = self.covariance, self.least_squares.factor.solve_transposed(whitened).T
        linear = covariance.linear_features(query) - weights @ covariance.centre_features
        return linear * covariance.slope_scale - covariance.cross_covariance_gradient(query, weights)


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
    points, values, input_scale = checked_data(points, values, input_scale)
    check_sizes(hyper_parameters, input_scale)
    covariance = hyper_parameters.covariance(kernel, points, input_scale)
    linear_features, noise = covariance.centre_features, hyper_parameters.noise_variance
    matrix = covariance_matrix(covariance.correlation_of_centres(), linear_features, noise)
    least_squares = fit_least_squares(factorise(matrix), values)
    return ExactGaussianProcess(points, values, input_scale, hyper_parameters, kernel, least_squares)
