"""Linear regression by least squares, with the leave-one-out residuals that it has in closed form."""

from typing import NamedTuple

import numpy as np

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
    left, projected = left[:, :rank], left[:, :rank].T @ values
    residual = values - left @ projected
    leverage = np.minimum(np.sum(left**2, axis=1), 1 - 1e-9)
    weights = right[:rank].T @ (projected / singular[:rank, None])
    return LinearFit(weights, residual, residual / (1 - leverage)[:, None], rank)
