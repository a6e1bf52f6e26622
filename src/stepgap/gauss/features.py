"""Features of a point: monomials, and waves whose weighted sum is a Gaussian process.

A sum of r waves √(2/r) cos(ωᵀx + b) with independent normal weights of standard deviation s tends, for many waves, to a
Gaussian process of the same standard deviation (random Fourier features: Rahimi and Recht, Random features for
large-scale kernel machines, 2007). Its kernel is the Fourier transform of the distribution of ω: for Student's t with 5
degrees of freedom and the scale 1/length, it is Matérn's with ν = 5/2 (Rasmussen and Williams, Sec. 4.2.1).
"""

from dataclasses import dataclass
from typing import Self, final

import numpy as np

from stepgap.gauss.monomials import monomials, monomials_gradient, number_of_monomials
from stepgap.step import Array

FREEDOM = 5
"""Degrees of freedom of Student's t, from which the frequencies of Matérn's kernel with ν = 5/2 are drawn."""


@final
@dataclass(frozen=True, eq=False)
class Features:
    """Features φ of a point in half ranges.

    Attributes:
        inputs: Number of coordinates of a point, d.
        degree: Degree of the monomials: 1 or 2.
        frequencies: ω of each wave [1 / half range]; shape (r, d).
        shifts: b of each wave [rad]; shape (r,).
    """

    inputs: int
    degree: int
    frequencies: Array
    shifts: Array

    @classmethod
    def drawn(cls, inputs: int, degree: int, waves: int, length: float, rng: np.random.Generator) -> Self:
        """Features with a number of random waves, of this length scale [half ranges]."""
        spread = np.sqrt(FREEDOM / rng.chisquare(FREEDOM, (waves, 1)))
        frequencies = spread * rng.normal(size=(waves, inputs)) / length
        return cls(inputs, degree, frequencies, rng.uniform(0.0, 2 * np.pi, waves))

    @property
    def monomials(self) -> int:
        """Number of monomials."""
        return number_of_monomials(self.inputs, self.degree)

    @property
    def waves(self) -> int:
        """Number of waves, r."""
        return len(self.shifts)

    @property
    def count(self) -> int:
        """Number of features, p."""
        return self.monomials + self.waves

    def __call__(self, point: Array) -> Array:
        """φ; (…, d) to (…, p). A point that is not finite gives NaN."""
        point = np.where(np.isfinite(point), point, np.nan)
        waves = self._amplitude * np.cos(point @ self.frequencies.T + self.shifts)
        return np.concatenate([monomials(point, self.degree), waves], axis=-1)

    def gradient(self, point: Array) -> Array:
        """∂φ/∂point; (…, d) to (…, p, d). A point that is not finite gives NaN."""
        point = np.where(np.isfinite(point), point, np.nan)
        slopes = -self._amplitude * np.sin(point @ self.frequencies.T + self.shifts)
        waves = slopes[..., None] * self.frequencies
        return np.concatenate([monomials_gradient(point, self.degree), waves], axis=-2)

    @property
    def _amplitude(self) -> float:
        return float(np.sqrt(2.0 / max(self.waves, 1)))
