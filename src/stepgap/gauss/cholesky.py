"""A Cholesky factor that grows row by row, and solves with it."""

from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.linalg import get_lapack_funcs

from stepgap.step import Array

LONGEST_TAIL = 128
"""Largest number of appended rows that are stored apart; with more, they are copied into one factor with the base."""

JITTERS = (0.0, 1e-12, 1e-10, 1e-8)
"""Numbers added to the diagonal, in turn, until the matrix can be factorised; in units of its largest entry."""

_potrf, _trtrs = get_lapack_funcs(("potrf", "trtrs"), dtype=np.float64)


@final
@dataclass(frozen=True, eq=False)
class Factor:
    """The lower triangular L = [[base, 0], [cross, tail]] with L Lᵀ = matrix + jitter · identity.

    Recently appended rows are stored apart from the base, so that appending one more copies only them.

    Attributes:
        base: Factor of the first B rows, Fortran-contiguous; shape (B, B).
        cross: Appended rows, left of the tail; shape (T, B).
        tail: Appended rows, right of the base, Fortran-contiguous; shape (T, T).
        jitter: Number added to the diagonal so that the matrix could be factorised.
    """

    base: Array
    cross: Array
    tail: Array
    jitter: float

    def __len__(self) -> int:
        return len(self.base) + len(self.tail)

    @property
    def diagonal(self) -> Array:
        """Pivots; shape (N,)."""
        return np.concatenate([self.base.diagonal(), self.tail.diagonal()])

    def assembled(self) -> Array:
        """L in one piece, Fortran-contiguous; shape (N, N)."""
        if not len(self.tail):
            return self.base
        size = len(self.base)
        assembled = np.zeros((len(self), len(self)), order="F")
        assembled[:size, :size], assembled[size:, :size], assembled[size:, size:] = self.base, self.cross, self.tail
        return assembled

    def solve(self, right: Array) -> Array:
        """L⁻¹ right; shapes (N,) or (N, Q)."""
        upper, _ = _trtrs(self.base, right[: len(self.base)], lower=1)
        if not len(self.tail):
            return upper
        lower, _ = _trtrs(self.tail, right[len(self.base) :] - self.cross @ upper, lower=1)
        return np.concatenate([upper, lower])

    def solve_transposed(self, right: Array) -> Array:
        """L⁻ᵀ right; shapes (N,) or (N, Q)."""
        if not len(self.tail):
            return _trtrs(self.base, right, lower=1, trans=1)[0]
        lower, _ = _trtrs(self.tail, right[len(self.base) :], lower=1, trans=1)
        upper, _ = _trtrs(self.base, right[: len(self.base)] - self.cross.T @ lower, lower=1, trans=1)
        return np.concatenate([upper, lower])

    def appended(self, row: Array, pivot: float) -> "Factor":
        """Returns the factor with one more row, in O(N · T).

        Args:
            row: New row left of the diagonal, as `solve` returns it for the new column of the matrix; shape (N,).
            pivot: New entry on the diagonal.
        """
        size, length = len(self.base), len(self.tail)
        tail = np.zeros((length + 1, length + 1), order="F")
        tail[:length, :length], tail[length, :length], tail[length, length] = self.tail, row[size:], pivot
        grown = Factor(self.base, np.concatenate([self.cross, row[None, :size]]), tail, self.jitter)
        return _in_one_piece(grown.assembled(), self.jitter) if length + 1 > LONGEST_TAIL else grown


def factorise(matrix: Array) -> Factor:
    """Factorises a positive semi-definite matrix with the least jitter that suffices.

    Args:
        matrix: C-contiguous; its strictly lower triangle is not read; shape (N, N).

    Raises:
        numpy.linalg.LinAlgError: The matrix is far from semi-definite.
    """
    diagonal = matrix.diagonal().copy()
    for jitter in diagonal.max() * np.array(JITTERS):
        np.fill_diagonal(matrix, diagonal + jitter)
        factor, failed = _potrf(matrix.T, lower=1)
        if not failed and is_safe(factor.diagonal().min() ** 2, diagonal):
            return _in_one_piece(factor, float(jitter))
    raise np.linalg.LinAlgError(f"the covariance of {len(matrix)} points is singular")


def is_safe(squared_pivot: float, diagonal: Array) -> bool:
    """Whether the square of the least pivot exceeds rounding errors, for a matrix with this diagonal (N,)."""
    return squared_pivot > len(diagonal) * np.finfo(float).eps * diagonal.max()


def _in_one_piece(factor: Array, jitter: float) -> Factor:
    return Factor(factor, np.empty((0, len(factor))), np.empty((0, 0), order="F"), jitter)
