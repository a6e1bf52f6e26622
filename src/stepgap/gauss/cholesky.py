"""Cholesky factors of covariance matrices, and solves with them."""

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
