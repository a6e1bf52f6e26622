"""Linear regression: by least squares, and with a conjugate prior of weights and noise."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from stepgap.step import Array

NEGLIGIBLE_SINGULAR_VALUE = 1e-10
"""Part of the largest singular value below which a direction of the basis counts as not there."""


class LinearFit(NamedTuple):
    """A fit values ≈ basis @ weights.

    Attributes:
        weights: The shortest of the best ones; shape (k, n).
        residual: values − basis @ weights; shape (N, n).
        left_out: Residual of each value in a fit to all others (Allen's PRESS); shape (N, n).
        rank: Number of independent columns of the basis.
    """

    weights: Array
    residual: Array
    left_out: Array
    rank: int


def fit_linear(basis: Array, values: Array) -> LinearFit:
    """Fits values (N, n) by the columns of a basis (N, k), which may depend on each other."""
    left, singular, right = np.linalg.svd(basis, full_matrices=False)
    rank = int(np.count_nonzero(singular > NEGLIGIBLE_SINGULAR_VALUE * singular[0]))
    left = left[:, :rank]
    projected = left.T @ values
    residual = values - left @ projected
    leverage = np.minimum(np.sum(left**2, axis=1), 1 - 1e-9)
    weights = right[:rank].T @ (projected / singular[:rank, None])
    return LinearFit(weights, residual, residual / (1 - leverage)[:, None], rank)


class LinearPosterior(NamedTuple):
    """What values say of weights w and noise of values φᵀw + noise (Gelman et al., Bayesian Data Analysis, Sec. 14.8).

    A priori w ~ N(0, noise² information⁻¹), and the variance of the noise is known as from some values (scaled inverse
    χ²). Then so it is a posteriori, with these sums; new values have Student's t distribution.

    Attributes:
        information: That of the prior + Σ φφᵀ; shape (k, k).
        projection: Σ φ value; shape (k,).
        squares: Those of the prior's values + Σ value².
        degrees_of_freedom: Number of the prior's values + number of values.
    """

    information: Array
    projection: Array
    squares: float
    degrees_of_freedom: float

    def learned(self, basis: Array, values: Array, counts: Array) -> "LinearPosterior":
        """Adds values (N,) at features (N, k), each counted `counts` times (N,); negative counts remove values."""
        return LinearPosterior(
            self.information + (counts * basis.T) @ basis,
            self.projection + (counts * values) @ basis,
            self.squares + float((counts * values) @ values),
            self.degrees_of_freedom + float(counts.sum()),
        )

    def solve(self, basis: Array) -> tuple[Array, Array, float]:
        """Weights (k,), information⁻¹ φ of rows φ (N, k), with shape (k, N), and the variance of a value's noise."""
        factor = cho_factor(self.information, lower=True)
        weights = cho_solve(factor, self.projection)
        noise_variance = (self.squares - float(self.projection @ weights)) / (self.degrees_of_freedom - 2)
        return weights, cho_solve(factor, basis.T), noise_variance
