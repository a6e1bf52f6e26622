"""Parabolas fitted to a signal about a time, and the standard error of what they give."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from stepgap.logs.sections.signals import Signal
from stepgap.step import Array

FEWEST_SAMPLES: Final = 6  # A parabola is fitted to at least this number of samples

OUTLYING: Final = 6.0
"""A sample whose residual exceeds this number of robust standard deviations, such as that of a dropout, is left out."""


UNUSUAL: Final = 2.0
"""A variance of residuals that is larger than the median of all fits by this factor is not due to chance."""


@final
@dataclass(frozen=True, eq=False)
class LocalFit:
    """A parabola, by least squares.

    Attributes:
        centre: Time that is zero in the basis [s].
        scale: Time that is one in the basis [s].
        coefficients: Of 1, s and s² with s = (time − centre) / scale; shape (3,).
        inverse: Inverse of the Gram matrix of this basis; shape (3, 3).
        extent: Difference of the largest and the smallest sample that was used.
        residuals: Of the samples that were used, in their order.
        runs: Number of runs of equal values among them: less than their number where a signal is rounded coarsely.
        outliers: Share of the samples that were left out.
    """

    centre: float
    scale: float
    coefficients: Array
    inverse: Array
    extent: float
    residuals: Array
    runs: int
    outliers: float

    def value(self, time: float) -> float:
        """Value at a time."""
        return float(self._basis(time) @ self.coefficients)

    def rate(self, time: float) -> float:
        """First derivative at a time [1/s]."""
        return float(self._rate_basis(time) @ self.coefficients)

    @property
    def acceleration(self) -> float:
        """Second derivative [1/s²]."""
        return float(2 * self.coefficients[2] / self.scale**2)

    def value_std(self, time: float, noise_std: float) -> float:
        """Standard error of `value`, given the standard deviation of the samples."""
        basis = self._basis(time)
        return noise_std * float(np.sqrt(basis @ self.inverse @ basis))

    def rate_std(self, time: float, noise_std: float) -> float:
        """Standard error of `rate`."""
        basis = self._rate_basis(time)
        return noise_std * float(np.sqrt(basis @ self.inverse @ basis))

    @property
    def top(self) -> float:
        """Time of the maximum; NaN if there is none."""
        _, slope, bend = self.coefficients
        return float(self.centre - self.scale * slope / (2 * bend)) if bend < 0 else float("nan")

    def top_std(self, noise_std: float) -> float:
        """Standard error of `top`, to first order: that of the rate there by the acceleration."""
        return self.rate_std(self.top, noise_std) / abs(self.acceleration)

    def _basis(self, time: float) -> Array:
        s = (time - self.centre) / self.scale
        return np.array([1.0, s, s * s])

    def _rate_basis(self, time: float) -> Array:
        return np.array([0.0, 1.0, 2 * (time - self.centre) / self.scale]) / self.scale


def fit_parabola(signal: Signal, centre: float, begin: float, end: float) -> LocalFit | None:
    """Fits the samples from `begin` to `end`; None if they are too few, or do not cover this time.

    Samples far off the parabola, by the median absolute residual, are left out.
    """
    part = signal.between(begin, end)
    width = end - begin
    if len(part) < FEWEST_SAMPLES or part.time[-1] - part.time[0] < 0.7 * width:
        return None
    s = (part.time - centre) / width
    basis = np.stack([np.ones_like(s), s, s * s], axis=-1)
    values = np.asarray(part.values, float)
    used = np.ones(len(s), bool)
    solver = _solver(basis)
    for _ in range(2):
        if solver is None:
            return None
        near = _near(basis, values, solver @ values[used])
        if (near == used).all():
            break
        used = near
        solver = _solver(basis[near])
    if solver is None or used.sum() < FEWEST_SAMPLES:
        return None
    coefficients = solver @ values[used]
    residuals = values[used] - basis[used] @ coefficients
    extent = float(np.ptp(values[used]))
    runs = 1 + int(np.count_nonzero(np.diff(values[used])))
    return LocalFit(centre, width, coefficients, solver @ solver.T, extent, residuals, runs, 1 - float(used.mean()))


def _solver(basis: Array) -> Array | None:
    """The matrix that gives the coefficients of least squares; None if they are not unique."""
    if len(basis) < basis.shape[1]:
        return None
    left, sizes, right = np.linalg.svd(basis, full_matrices=False)
    if sizes[-1] <= sizes[0] * len(basis) * np.finfo(float).eps:
        return None
    return np.asarray(right.T @ (left.T / sizes[:, np.newaxis]), float)


def _near(basis: Array, values: Array, coefficients: Array) -> NDArray[np.bool_]:
    """The samples near a parabola: within `OUTLYING` robust standard deviations."""
    residuals = np.abs(values - basis @ coefficients)
    return residuals <= OUTLYING * 1.4826 * np.median(residuals) + 1e-12 * np.ptp(values)


def noise_std_of(fits: Sequence[LocalFit], resolution: float) -> Array:
    """For each fit, the standard deviation of independent errors that would make it as uncertain as the real ones do.

    The variance of the residuals is multiplied by (1 + ρ) / (1 − ρ), where ρ is the correlation of successive residuals
    (Bartlett's formula for first-order autoregressive errors). Both are the medians of all fits, or those of a single
    fit if its variance is `UNUSUAL`, for example because the sensor repeated a value. Errors of rounding are equal as
    long as the signal hardly changes, so their variance, resolution² / 12, counts once for each run of equal values.

    Args:
        fits: Fits to parts of the signal, at least one.
        resolution: Smallest difference of two values of the signal.
    """
    squares = np.array([fit.residuals @ fit.residuals for fit in fits])
    products = np.array([fit.residuals[1:] @ fit.residuals[:-1] for fit in fits])
    counts = np.array([len(fit.residuals) for fit in fits])
    variances = squares / (counts - 3)
    correlations = products / np.where(squares > 0, squares, 1)
    typical = np.median(variances)
    correlation = np.median(correlations)
    unusual = variances > UNUSUAL * typical
    variances = np.where(unusual, variances, typical)
    correlations = np.clip(np.where(unusual, np.maximum(correlations, correlation), correlation), 0, 0.98)
    rounding = resolution**2 / 12 * counts / np.array([fit.runs for fit in fits])
    return np.sqrt(np.maximum(variances * (1 + correlations) / (1 - correlations), rounding))


def resolution_of(signal: Signal) -> float:
    """Smallest difference of two values, such as the step of an encoder; not less than the rounding of the largest."""
    values = np.unique(np.asarray(signal.values, float))
    return max(float(np.diff(values).min()) if len(values) > 1 else 0.0, rounding_of(values))


def rounding_of(values: Array) -> float:
    """What the largest of some values may be rounded by, in double precision; differences up to it mean nothing."""
    return float(np.finfo(float).eps * np.abs(values).max(initial=0.0))
