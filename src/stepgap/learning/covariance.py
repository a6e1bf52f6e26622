"""Covariance of f and the slopes of a Gaussian process, divided by signal², and what changes it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist

from stepgap.base.compiled import compiled
from stepgap.step import Array

KERNEL_BLOCK = 2**16
"""Kernel values computed at a time, so that a large batch of queries stays in the cache."""


def kernel(distance: Array) -> Array:
    """Matérn-5/2, k as a function of √5 r (RW Eq. 4.17)."""
    return (1 + distance + distance**2 / 3) * np.exp(-distance)


def kernel_descent(distance: Array) -> Array:
    """−(dk/dr) / r as a function of √5 r; finite where two points meet."""
    return 5 / 3 * (1 + distance) * np.exp(-distance)


@final
@dataclass(frozen=True, eq=False)
class Covariance:
    """Covariance of queries (Q, d) and fixed centres, all in the units of the inputs.

    Attributes:
        centres: Shape (M, d).
        origin: Where slopes turn about; shape (d,).
        reach: Length scales; shape (d,).
        steepness: Slopes of one standard deviation [signals per unit of each input]; shape (d,).
    """

    centres: Array
    origin: Array
    reach: Array
    steepness: Array

    @cached_property
    def centre_lean(self) -> Array:
        """`lean` of the centres; shape (M, d)."""
        return self.lean(self.centres)

    @cached_property
    def _scaled(self) -> Array:
        """Centres in length scales; shape (M, d)."""
        return self.centres / self.reach

    def lean(self, query: Array) -> Array:
        """What slopes of one standard deviation add between the origin and queries [signals]; shape (Q, d)."""
        return (query - self.origin) * self.steepness

    def prior(self, query: Array) -> Array:
        """Variance of queries without data; shape (Q,)."""
        return 1 + (self.lean(query) ** 2).sum(axis=1)

    def distance(self, query: Array) -> Array:
        """√5 r between queries and centres; shape (Q, M)."""
        return np.sqrt(5 * cdist(query / self.reach, self._scaled, "sqeuclidean"))

    def kernel(self, query: Array) -> Array:
        """Covariance of f; shape (Q, M)."""
        return kernel(self.distance(query))

    def kernel_gradient(self, query: Array, weights: Array) -> Array:
        """∂(kernel @ weights)/∂query for weights (M,) or (Q, M); shape (Q, d)."""
        pull = kernel_descent(self.distance(query)) * weights
        return (pull @ self._scaled - pull.sum(axis=1, keepdims=True) * (query / self.reach)) / self.reach

    def blockwise(self, evaluate: Callable[[Array], Array], point: ArrayLike) -> Array:
        """Apply `evaluate` to blocks (Q, d) of points (…, d); shape (…) or (…, d). What is not finite gives NaN."""
        point = np.asarray(point, float)
        query = np.where(np.isfinite(point), point, np.nan).reshape(-1, len(self.reach))
        rows = max(1, KERNEL_BLOCK // len(self.centres))
        blocks = [evaluate(query[start : start + rows]) for start in range(0, max(1, len(query)), rows)]
        result = np.concatenate(blocks) if len(blocks) > 1 else blocks[0]
        return result.reshape(point.shape[:-1] + result.shape[1:])


@compiled
def covariance_matrix(correlation: Array, lean: Array, noise: float) -> Array:
    """Upper triangle of what has `correlation` + lean leanᵀ off its diagonal and 1 + noise more on it.

    Args:
        correlation: Kernel of every pair of points, in the order of SciPy's `pdist`; shape (N(N−1)/2,).
        lean: What slopes of one standard deviation add to each point; shape (N, d).
        noise: Variance of the noise.

    Returns:
        C-contiguous; zero below the diagonal; shape (N, N).
    """
    size, inputs = lean.shape
    matrix = np.zeros((size, size))
    pair = 0
    for i in range(size):
        for j in range(i, size):
            slopes = 0.0
            for k in range(inputs):
                slopes += lean[i, k] * lean[j, k]
            if j > i:
                matrix[i, j] = correlation[pair] + slopes
                pair += 1
            else:
                matrix[i, i] = 1.0 + slopes + noise
    return matrix


@compiled
def evidence_gradient(
    inverse: Array, explained: Array, descent: Array, points: Array, lean: Array
) -> tuple[Array, float, float]:
    """½ tr((explained explainedᵀ − C⁻¹) dC) for changes dC of the covariance C (RW Eq. 5.9).

    Args:
        inverse: C⁻¹, C-contiguous; only its upper triangle is read; shape (N, N).
        explained: Shape (N, 2).
        descent: `kernel_descent` of every pair of points, in the order of SciPy's `pdist`; shape (N(N−1)/2,).
        points: In input scales; shape (N, d).
        lean: As for `covariance_matrix`; shape (N, d).

    Returns:
        For dC with log(length scale), divided by length scale⁻², shape (d,); with log(lean); with half the noise.
    """
    size, inputs = points.shape
    by_length_scale = np.zeros(inputs)
    by_lean, by_noise = 0.0, 0.0
    pair = 0
    for i in range(size):
        excess = explained[i, 0] ** 2 + explained[i, 1] ** 2 - inverse[i, i]
        by_noise += excess
        for k in range(inputs):
            by_lean += excess * lean[i, k] ** 2
        for j in range(i + 1, size):
            excess = explained[i, 0] * explained[j, 0] + explained[i, 1] * explained[j, 1] - inverse[i, j]
            pull = excess * descent[pair]
            pair += 1
            for k in range(inputs):
                by_length_scale[k] += pull * (points[i, k] - points[j, k]) ** 2
                by_lean += 2 * excess * lean[i, k] * lean[j, k]
    return by_length_scale, by_lean, by_noise
