"""Least squares with one effect per level of each axis, in many samples at the same time."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stepgap.step import Array
from stepgap.sweep.report.cases import LevelCodes, SweepAxis

_SWEEPS = 100
_TOLERANCE = 1e-10


class AdditiveModel(NamedTuple):
    """Sum of one effect per axis, fitted to n rows of N values.

    Attributes:
        axes: The axes.
        effects: Effects of the levels of each axis; shapes (n, L).
        remainder: Difference of the values from the model; shape (n, N).
    """

    axes: Sequence[SweepAxis]
    effects: Sequence[Array]
    remainder: Array


def additive_model(values: Array, axes: Sequence[SweepAxis]) -> AdditiveModel:
    """Fits an additive model by least squares: each axis in turn takes the means of the remainder (backfitting).

    If all combinations of levels are equally frequent, the first turn is exact.

    Args:
        values: Values with mean zero; shape (n, N).
        axes: Axes with the levels of the N cases.
    """
    remainder = values.copy()
    effects = [np.zeros((len(values), len(axis.levels))) for axis in axes]
    counts = [np.maximum(np.bincount(axis.codes, minlength=len(axis.levels)), 1) for axis in axes]
    for _ in range(_SWEEPS):
        largest = 0.0
        for axis, effect, number in zip(axes, effects, counts, strict=True):
            change = sums_by_level(remainder, axis.codes, len(axis.levels)) / number
            effect += change
            remainder -= change[:, axis.codes]
            largest = max(largest, float(np.abs(change).max()))
        if largest <= _TOLERANCE * float(np.abs(values).max()):
            break
    return AdditiveModel(axes, effects, remainder)


def sums_by_level(values: Array, codes: LevelCodes, levels: int) -> Array:
    """Sums of values by level; (n, N) to (n, L)."""
    return np.array([np.bincount(codes, row, levels) for row in values], float)


def explained_by_levels(counts: Array, sums: Array) -> Array:
    """Sum of squares that the means of levels explain; counts (D, L) and sums (n, D, L) to (n, D)."""
    return np.sum(np.divide(sums**2, counts, out=np.zeros_like(sums), where=counts > 0), axis=2)


def explained_by_two(counts: Array, sums: Array) -> tuple[Array, Array]:
    """Sum of squares that the effects of two axes explain in each of D samples, and the number of independent effects.

    The effects of the axis with more levels are eliminated from the normal equations.

    Args:
        counts: Numbers of values by combination of levels; shape (D, L, M).
        sums: Sums of values by combination; shape (n, D, L, M).

    Returns:
        Arrays of shapes (n, D) and (D,).
    """
    if counts.shape[1] < counts.shape[2]:
        counts, sums = counts.swapaxes(1, 2), sums.swapaxes(2, 3)
    rows = counts.sum(axis=2)
    inverse = np.divide(1.0, rows, out=np.zeros(rows.shape), where=rows > 0)
    scaled = counts * inverse[:, :, np.newaxis]
    matrix = -np.einsum("dlm,dlk->dmk", counts, scaled)
    matrix[:, range(counts.shape[2]), range(counts.shape[2])] += counts.sum(axis=1)
    target = sums.sum(axis=2) - np.einsum("ndl,dlm->ndm", sums.sum(axis=3), scaled)
    values, vectors = np.linalg.eigh(matrix)
    regular = values > 1e-9 * np.maximum(values[:, -1:], 1)
    projected = np.einsum("ndm,dmk->ndk", target, vectors) ** 2
    explained = np.sum(np.divide(projected, values, out=np.zeros_like(projected), where=regular), axis=2)
    explained += np.sum(sums.sum(axis=3) ** 2 * inverse, axis=2)
    return explained, np.count_nonzero(inverse, axis=1) + np.count_nonzero(regular, axis=1)
