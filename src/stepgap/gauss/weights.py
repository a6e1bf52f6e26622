"""Bayesian linear regression, one value at a time: a normal distribution of weights, and what a value says of them.

A value y = φᵀw + noise has weights w ~ N(mean, P) beforehand. After y has been measured with the noise variance r, they
are again normal (a Kalman filter's measurement; Bishop, Pattern Recognition and Machine Learning, Sec. 3.3):

    gain = P φ / (φᵀPφ + r),   mean ← mean + gain (y − φᵀ mean),   P ← P − gain φᵀP

P is kept as its lower triangular root, P = root rootᵀ, so that it stays positive however many values there are. The
root is updated without ever computing P: after a value by Carlson's algorithm, after a random walk by that of Cholesky
(Maybeck, Stochastic Models, Estimation, and Control, Vol. 1, Sec. 7.5; Golub and Van Loan, Matrix Computations, Sec.
6.5.4). Both cost k² for k weights.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self, final

import numpy as np

from stepgap.base.compiled import compiled
from stepgap.step import Array


class Predicted(NamedTuple):
    """Expected values, and their variances without noise; shapes (…, n)."""

    mean: Array
    variance: Array


@final
@dataclass(frozen=True, eq=False)
class Weights:
    """Normal distributions of the weights of n values that have the same k features; immutable.

    Attributes:
        mean: Shape (n, k).
        root: Lower triangular roots of the covariances; shape (n, k, k).
    """

    mean: Array
    root: Array

    @classmethod
    def of_moments(cls, mean: Array, covariance: Array) -> Self:
        """Weights with these means (n, k) and covariances (n, k, k)."""
        return cls(mean, np.asarray(np.linalg.cholesky(covariance), float))

    @property
    def covariance(self) -> Array:
        """Covariances P; shape (n, k, k)."""
        return self.root @ np.swapaxes(self.root, -1, -2)

    def predicted(self, features: Array) -> Predicted:
        """Values at features (…, k)."""
        spread = np.einsum("...k,nkj->...nj", features, self.root)
        return Predicted(features @ self.mean.T, np.sum(spread**2, axis=-1))

    def learned(self, features: Array, values: Array, noise: Array) -> "Weights":
        """Weights after a value of each of the n, at features (k,), with noise of these variances (n,)."""
        return Weights(*_conditioned(self.mean, self.root, features, values, noise))

    def walked(self, places: Sequence[int], variance: Array) -> "Weights":
        """Weights at some places one step of a random walk later, which adds these variances (n,) to each of them."""
        return replace(self, root=_walked(self.root, np.array(places), np.sqrt(variance)))

    def widened(self, covariance: Array) -> "Weights":
        """Weights to which independent numbers with these covariances (n, k, k) have been added."""
        return Weights.of_moments(self.mean, self.covariance + covariance)

    def restarted(self, places: Sequence[int], variance: Array) -> "Weights":
        """Weights of which nothing is known at some places but that they are zero with variances (n, places)."""
        mean = self.mean.copy()
        covariance = self.covariance
        mean[:, places] = 0.0
        covariance[:, places, :] = 0.0
        covariance[:, :, places] = 0.0
        covariance[:, places, places] = variance
        return Weights.of_moments(mean, covariance)


@compiled
def _conditioned(mean, root, features, values, noise):
    """Mean and root of the weights of each value after it was measured (Carlson's algorithm)."""
    count, size = mean.shape
    new_mean = np.empty_like(mean)
    new_root = np.zeros_like(root)
    cross = np.empty(size)
    for n in range(count):
        # From the last column to the first, `total` grows from the noise to φᵀPφ + noise and `cross` to P φ. Column j
        # of the root has zeros above the diagonal, and so has `cross` above j: the new root is triangular again.
        total = noise[n]
        cross[:] = 0.0
        for j in range(size - 1, -1, -1):
            column = root[n, j:, j]
            along = np.sum(column * features[j:])
            before = total
            total += along**2
            kept = np.sqrt(before / total)
            moved = along / np.sqrt(before * total)
            new_root[n, j:, j] = kept * column - moved * cross[j:]
            cross[j:] += along * column
        error = values[n] - np.sum(mean[n] * features)
        new_mean[n] = mean[n] + cross * (error / total)
    return new_mean, new_root


@compiled
def _walked(root, places, std):
    """Roots after std² was added on the diagonal at some places (rank-one updates by Givens rotations)."""
    new = root.copy()
    size = root.shape[1]
    added = np.empty(size)
    for n in range(len(root)):
        for place in places:
            added[:] = 0.0
            added[place] = std[n]
            for j in range(place, size):
                radius = np.sqrt(new[n, j, j] ** 2 + added[j] ** 2)
                cosine = new[n, j, j] / radius
                sine = added[j] / radius
                column = new[n, j:, j].copy()
                new[n, j:, j] = cosine * column + sine * added[j:]
                added[j:] = cosine * added[j:] - sine * column
    return new
