"""Covariance of the values of a Gaussian process, divided by signal², and what changes it."""

import numpy as np

from stepgap.hybrid.compiled import compiled
from stepgap.step import Array


def kernel(distance: Array) -> Array:
    """Matérn-5/2, k as a function of √5 r (RW Eq. 4.17)."""
    return (1 + distance + distance**2 / 3) * np.exp(-distance)


def kernel_descent(distance: Array) -> Array:
    """−(dk/dr) / r as a function of √5 r; finite where two points meet."""
    return 5 / 3 * (1 + distance) * np.exp(-distance)


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
