"""The constant basis of a Gaussian process, fitted by generalised least squares."""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from stepgap.gauss.cholesky import Factor
from stepgap.step import Array


@final
@dataclass(frozen=True, eq=False)
class LeastSquares:
    """The fit values = β + error, where the error has the covariance signal_std² C.

    Attributes:
        factor: Cholesky factor of C, shape (N, N).
        basis: factor⁻¹ 1; shape (N,).
        whitened: factor⁻¹ values; shape (N,).
        coefficient: β = 1ᵀC⁻¹ values / 1ᵀC⁻¹1 [unit of the values].
        weights: C⁻¹ (values − β), whose sum is zero; shape (N,).
        quadratic_form: (values − β)ᵀ C⁻¹ (values − β).
    """

    factor: Factor
    basis: Array
    whitened: Array
    coefficient: float
    weights: Array
    quadratic_form: float

    def log_likelihood(self, signal: float) -> float:
        """Logarithm of p(values | β), for a standard deviation of the signal, at this β (RW Eq. 2.30)."""
        half_log_determinant = np.log(self.factor.diagonal).sum() + len(self.weights) * math.log(signal)
        constant = 0.5 * len(self.weights) * math.log(2 * math.pi)
        return float(-0.5 * self.quadratic_form / signal**2 - half_log_determinant - constant)

    def log_evidence(self, signal: float) -> float:
        """Logarithm of ∫ p(values | β) dβ, in which only differences of the values count (RW Eq. 2.45)."""
        return self.log_likelihood(signal) + math.log(signal) + 0.5 * math.log(2 * math.pi / (self.basis @ self.basis))


def fit_least_squares(factor: Factor, values: Array) -> LeastSquares:
    """Fits the constant to values (N,)."""
    basis, whitened = factor.solve(np.stack([np.ones(len(values)), values]).T).T
    return _regress(factor, basis, whitened)


def append_value(solved: LeastSquares, row: Array, pivot: float, value: float) -> LeastSquares:
    """Updates a fit with one more value, in O(N²).

    Args:
        solved: The fit without it.
        row: The factor's new row, left of the diagonal; shape (N,).
        pivot: The factor's new entry on the diagonal.
        value: The new value.
    """
    basis, whitened = (
        np.append(old, (new - row @ old) / pivot) for old, new in ((solved.basis, 1.0), (solved.whitened, value))
    )
    return _regress(solved.factor.appended(row, pivot), basis, whitened)


def _regress(factor: Factor, basis: Array, whitened: Array) -> LeastSquares:
    coefficient = float(basis @ whitened / (basis @ basis))
    error = whitened - coefficient * basis
    return LeastSquares(factor, basis, whitened, coefficient, factor.solve_transposed(error), float(error @ error))
