"""Gradients of a residual that its data leave possible: samples of its posterior.

A regression gives the standard deviation of its value but not that of its gradient. The covariance of the gradient
follows from how the gradient changes if one more value is learned: in linear-Gaussian models, which all Gaussian
processes with given hyper-parameters and linear regressions are, learning a value that lies δ above the expected one at
a point x' changes the expected gradient at x by Cov(∇f(x), f(x')) δ / (Var f(x') + noise²).
"""

from typing import Final

import numpy as np

from stepgap.learning.residual import Residual
from stepgap.step import Array

DISTANCE: Final = 0.05
"""Distance over which covariances are differentiated, in half ranges."""


def gradient_covariance(residual: Residual, point: Array, scale: Array) -> Array:
    """Posterior covariance of the gradient of each state coordinate's residual at a point.

    Args:
        residual: The residual; its inputs from earlier steps, if it has any, must be known.
        point: State and command; shape (d,), d = n + m.
        scale: Half ranges of state and command; shape (d,).

    Returns:
        Covariances; shape (n, d, d).
    """
    steps = DISTANCE * np.diag(scale)
    ahead, behind = ([_with_value(residual, point, sign * step) for step in steps] for sign in (1.0, -1.0))
    slopes = (np.array(ahead) - np.array(behind)) / (2 * DISTANCE * scale)[:, None, None]
    covariance = np.moveaxis(slopes, 0, 1)  # (d, n, d) to (n, d, d)
    return (covariance + np.swapaxes(covariance, -1, -2)) / 2


def gradient_samples(residual: Residual, point: Array, scale: Array, count: int, rng: np.random.Generator) -> Array:
    """Samples of the gradient from its posterior, independent for each state coordinate; shape (count, n, d).

    Args:
        residual: As of `gradient_covariance`.
        point: As of `gradient_covariance`.
        scale: As of `gradient_covariance`.
        count: Number of samples.
        rng: Draws the samples.
    """
    values, vectors = np.linalg.eigh(gradient_covariance(residual, point, scale) * np.outer(scale, scale))
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :] / scale[:, None]
    normal = rng.normal(size=(count, *values.shape))
    return residual.mean_gradient(point) + np.einsum("nij,cnj->cni", roots, normal)


def _with_value(residual: Residual, point: Array, offset: Array) -> Array:
    """Covariance of the gradient at a point with the value at another one; shape (n, d)."""
    other = point + offset
    std = residual.std(other, include_noise=True)
    learned = residual.append(other, residual.mean(other) + std)
    return (learned.mean_gradient(point) - residual.mean_gradient(point)) * std[:, None]
