"""Covariance of f and the linear features of a Gaussian process, divided by signal², and its derivatives."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist, pdist

from stepgap.base.compiled import compiled
from stepgap.gauss.kernel import Kernel
from stepgap.step import Array

KERNEL_BLOCK = 2**16
"""Number of kernel values computed at once, so that a large batch of queries stays in the cache."""


@final
@dataclass(frozen=True, eq=False)
class Covariance:
    """Covariance of queries (Q, d) and fixed centres, all in the units of the inputs.

    The linear features of a point are `(point - origin) * slope_scale`, the values there of slopes of one standard
    deviation.

    Attributes:
        kernel: Covariance of f.
        centres: Shape (M, d).
        origin: Where the linear features are zero; shape (d,).
        length_scale: Shape (d,).
        slope_scale: Slopes of one standard deviation [signals per unit of each input]; shape (d,).
    """

    kernel: Kernel
    centres: Array
    origin: Array
    length_scale: Array
    slope_scale: Array

    @cached_property
    def centre_features(self) -> Array:
        """Linear features of the centres [signals]; shape (M, d)."""
        return self.linear_features(self.centres)

    @cached_property
    def _scaled(self) -> Array:
        """Centres in length scales; shape (M, d)."""
        return self.centres / self.length_scale

    def linear_features(self, query: Array) -> Array:
        """Linear features of queries [signals]; shape (Q, d)."""
        return (query - self.origin) * self.slope_scale

    def prior_variance(self, query: Array) -> Array:
        """Variance of queries without data; shape (Q,)."""
        return 1 + (self.linear_features(query) ** 2).sum(axis=1)

    def cross_covariance(self, query: Array) -> Array:
        """Covariance of f at queries and centres; shape (Q, M)."""
        return self.kernel.covariance(self._squared_distance(query))

    def cross_covariance_gradient(self, query: Array, weights: Array) -> Array:
        """∂(cross_covariance @ weights)/∂query for weights (M,) or (Q, M); shape (Q, d)."""
        dk_dr = self.kernel.radial_derivative(self._squared_distance(query)) * weights
        return (
            dk_dr.sum(axis=1, keepdims=True) * (query / self.length_scale) - dk_dr @ self._scaled
        ) / self.length_scale

    def correlation_of_centres(self) -> Array:
        """Covariance of f at every pair of centres, in the order of SciPy's `pdist`; shape (M(M−1)/2,)."""
        return self.kernel.covariance(np.asarray(pdist(self._scaled, "sqeuclidean"), float))

    def blockwise(self, evaluate: Callable[[Array], Array], point: ArrayLike) -> Array:
        """Applies `evaluate` to blocks (Q, d) of points (…, d); shape (…) or (…, d). Non-finite points give NaN."""
        point = np.asarray(point, float)
        query = np.where(np.isfinite(point), point, np.nan).reshape(-1, len(self.length_scale))
        rows = max(1, KERNEL_BLOCK // len(self.centres))
        blocks = [evaluate(query[start : start + rows]) for start in range(0, max(1, len(query)), rows)]
        result = np.concatenate(blocks) if len(blocks) > 1 else blocks[0]
        return result.reshape(point.shape[:-1] + result.shape[1:])

    def _squared_distance(self, query: Array) -> Array:
        """r² of queries and centres; shape (Q, M)."""
        return np.asarray(cdist(query / self.length_scale, self._scaled, "sqeuclidean"), float)


@compiled
def covariance_matrix(correlation: Array, linear_features: Array, noise: float) -> Array:
    """Upper triangle of K = k + ΦΦᵀ + noise · identity, with the linear features Φ.

    Args:
        correlation: Kernel k of every pair of points, in the order of SciPy's `pdist`; shape (N(N−1)/2,).
        linear_features: Φ; shape (N, d).
        noise: Variance of the noise.

    Returns:
        C-contiguous; zero below the diagonal; shape (N, N).
    """
    size, inputs = linear_features.shape
    matrix = np.zeros((size, size))
    pair = 0
    for i in range(size):
        for j in range(i, size):
            slopes = 0.0
            for k in range(inputs):
                slopes += linear_features[i, k] * linear_features[j, k]
            if j > i:
                matrix[i, j] = correlation[pair] + slopes
                pair += 1
            else:
                matrix[i, i] = 1.0 + slopes + noise
    return matrix


@compiled
def evidence_gradient(K_inv: Array, alpha: Array, dk_dr: Array, X: Array, Phi: Array) -> tuple[Array, float, float]:
    """½ tr((ααᵀ − K⁻¹) ∂K/∂θ), the gradient of the log evidence (RW Eq. 5.9), for three kinds of parameter θ.

    One column of `alpha` is RW's α = K⁻¹ values; the other one comes from integrating out the constant.

    Args:
        K_inv: K⁻¹, C-contiguous; only its upper triangle is read; shape (N, N).
        alpha: Shape (N, 2).
        dk_dr: `Kernel.radial_derivative` of every pair of points, in the order of SciPy's `pdist`; shape (N(N−1)/2,).
        X: Points in input scales; shape (N, d).
        Phi: Linear features; shape (N, d).

    Returns:
        For θ = log(length scale) of each input, divided by length scale⁻², shape (d,); for θ = log(slope scale); for
        θ = log(standard deviation of the noise), divided by the variance of the noise.
    """
    size, inputs = X.shape
    by_length_scale = np.zeros(inputs)
    by_slope_scale = 0.0
    by_noise = 0.0
    pair = 0
    for i in range(size):
        excess = alpha[i, 0] ** 2 + alpha[i, 1] ** 2 - K_inv[i, i]
        by_noise += excess
        for k in range(inputs):
            by_slope_scale += excess * Phi[i, k] ** 2
        for j in range(i + 1, size):
            excess = alpha[i, 0] * alpha[j, 0] + alpha[i, 1] * alpha[j, 1] - K_inv[i, j]
            radial = excess * dk_dr[pair]
            pair += 1
            for k in range(inputs):
                by_length_scale[k] -= radial * (X[i, k] - X[j, k]) ** 2
                by_slope_scale += 2 * excess * Phi[i, k] * Phi[j, k]
    return by_length_scale, by_slope_scale, by_noise
