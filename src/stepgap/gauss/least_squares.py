"""Cholesky factors of covariance matrices, and the constant of a Gaussian process by generalised least squares."""

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.linalg import get_lapack_funcs

from stepgap.step import Array

JITTERS = (0.0, 1e-12, 1e-10, 1e-8)
"""Numbers added to the diagonal, in turn, until the matrix can be factorised; in units of its largest entry."""

_potrf, _potri, _trtrs = get_lapack_funcs(("potrf", "potri", "trtrs"), dtype=np.float64)


def factorise(matrix: Array) -> Array:
    """The lower triangular L with L Lᵀ = matrix + jitter · identity, with the least jitter that suffices.

    Args:
        matrix: C-contiguous; its strictly lower triangle is not read, and its diagonal changes; shape (N, N).

    Returns:
        Fortran-contiguous; zero above the diagonal; shape (N, N).

    Raises:
        numpy.linalg.LinAlgError: The matrix is far from semi-definite.
    """
    diagonal = matrix.diagonal().copy()
    rounding = len(diagonal) * np.finfo(float).eps * diagonal.max()
    for jitter in diagonal.max() * np.array(JITTERS):
        np.fill_diagonal(matrix, diagonal + jitter)
        factor, failed = _potrf(matrix.T, lower=1)
        if not failed and factor.diagonal().min() ** 2 > rounding:
            return factor
    raise np.linalg.LinAlgError(f"the covariance of {len(matrix)} points is singular")


def solve(factor: Array, right: Array) -> Array:
    """L⁻¹ right; shapes (N,) or (N, Q)."""
    return _trtrs(factor, right, lower=1)[0]


def solve_transposed(factor: Array, right: Array) -> Array:
    """L⁻ᵀ right; shapes (N,) or (N, Q)."""
    return _trtrs(factor, right, lower=1, trans=1)[0]


def inverse_triangle(factor: Array) -> Array:
    """(L Lᵀ)⁻¹, its upper triangle; C-contiguous; shape (N, N)."""
    return _potri(factor, lower=1)[0].T


@final
@dataclass(frozen=True, eq=False)
class LeastSquares:
    """The fit values = β + error, where the error has the covariance signal_std² C.

    Attributes:
        factor: Cholesky factor L of C, shape (N, N).
        basis: L⁻¹ 1; shape (N,).
        coefficient: β = 1ᵀC⁻¹ values / 1ᵀC⁻¹1 [unit of the values].
        weights: C⁻¹ (values − β), whose sum is zero; shape (N,).
        quadratic_form: (values − β)ᵀ C⁻¹ (values − β).
    """

    factor: Array
    basis: Array
    coefficient: float
    weights: Array
    quadratic_form: float

    def log_likelihood(self, signal: float) -> float:
        """Logarithm of p(values | β), for a standard deviation of the signal, at this β (RW Eq. 2.30)."""
        half_log_determinant = np.log(self.factor.diagonal().copy()).sum() + len(self.weights) * math.log(signal)
        constant = 0.5 * len(self.weights) * math.log(2 * math.pi)
        return float(-0.5 * self.quadratic_form / signal**2 - half_log_determinant - constant)

    def log_evidence(self, signal: float) -> float:
        """Logarithm of ∫ p(values | β) dβ, in which only differences of the values count (RW Eq. 2.45)."""
        return self.log_likelihood(signal) + math.log(signal) + 0.5 * math.log(2 * math.pi / (self.basis @ self.basis))


def fit_least_squares(factor: Array, values: Array) -> LeastSquares:
    """Fits the constant to values (N,), given the Cholesky factor of C."""
    basis, whitened = solve(factor, np.stack([np.ones(len(values)), values]).T).T
    coefficient = float(basis @ whitened / (basis @ basis))
    error = whitened - coefficient * basis
    return LeastSquares(factor, basis, coefficient, solve_transposed(factor, error), float(error @ error))
