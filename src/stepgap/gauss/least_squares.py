"""The constant basis of a Gaussian process, fitted by generalised least squares."""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from stepgap.gauss.cholesky import solve, solve_transposed
from stepgap.step import Array


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
