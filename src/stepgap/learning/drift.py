"""What changes from hop to hop while the robot hops: an offset that follows what the residual leaves.

A floor or a boom that leans, a motor that warms up or a slack cable shift the next state by something that is no
function of state and command but alike from one hop to the next, or whenever the robot comes round to the same place.
Each coordinate has Kalman filters side by side for an offset c₀ + c₁ sin ψ + c₂ cos ψ at place ψ, whose coefficients
walk at random, in each filter at another rate; the one that has predicted best of late is used. One more follows
nothing, so that where nothing drifts nothing is added. Where the place is not known, c₀ alone is followed: an
exponential mean.
"""

from dataclasses import dataclass, replace
from math import cos, isnan, sin
from typing import Self, final

import numpy as np
from numpy.typing import NDArray

from stepgap.step import Array

RATES = np.array([0.02, 0.05, 0.1, 0.2, 0.4])
"""Standard deviation of a coefficient's change in a step, in those of a step's noise; at first it is 1."""
REMEMBERED = 0.98
"""Weight of a filter's score from one step to the next: about the last 50 steps count."""
RELUCTANCE = 5.0
"""Steps' worth of typical squares by which a filter must have been better before following nothing is left."""


@final
@dataclass(frozen=True, eq=False)
class Drift:
    """Filters of all rates; immutable.

    Attributes:
        coefficients: c of each filter; shape (rates, 3, n).
        covariance: Of c, in variances of a step's noise; shape (rates, 3, 3).
        scores: Discounted squares of what was missed by following nothing, then by each filter; shape (1 + rates, n).
        weight: Discounted number of steps.
    """

    coefficients: Array
    covariance: Array
    scores: Array
    weight: float = 0.0

    @classmethod
    def none(cls, size: int) -> Self:
        """Before the first step, for n coordinates."""
        rates = len(RATES)
        return cls(np.zeros((rates, 3, size)), np.tile(np.eye(3), (rates, 1, 1)), np.zeros((1 + rates, size)))

    def offset(self, place: float) -> Array:
        """What to add to the predicted state of a step that starts at a place [rad], or at none (NaN); shape (n,)."""
        return self._offsets(_terms(place))[self._best, np.arange(self.scores.shape[1])]

    def doubt(self, place: float) -> Array:
        """Standard deviation of that offset, in those of a step's noise; shape (n,)."""
        terms = _terms(place)
        return np.sqrt(np.append(0.0, self.covariance @ terms @ terms))[self._best]

    def followed(self, left: Array, place: float) -> "Drift":
        """After a step from a place [rad] of which the map without this offset left an error; shape (n,)."""
        terms = _terms(place)
        missed = left - self._offsets(terms)
        covariance = self.covariance + RATES[:, None, None] ** 2 * np.eye(3)
        seen = covariance @ terms
        gain = seen / (seen @ terms + 1.0)[:, None]
        return replace(
            self,
            coefficients=self.coefficients + gain[:, :, None] * missed[1:, None, :],
            covariance=covariance - gain[:, :, None] * seen[:, None, :],
            scores=REMEMBERED * self.scores + missed**2,
            weight=REMEMBERED * self.weight + 1.0,
        )

    @property
    def _best(self) -> NDArray[np.intp]:
        """Which filter is used, 0 for none; shape (n,)."""
        typical = self.scores[0] / max(self.weight, 1.0)
        handicap = np.where(np.arange(len(self.scores)) > 0, RELUCTANCE, 0.0)[:, None] * typical
        return np.argmin(self.scores + handicap, axis=0)

    def _offsets(self, terms: Array) -> Array:
        """Nothing, then what each filter says; shape (1 + rates, n)."""
        followed = np.einsum("k,rkn->rn", terms, self.coefficients)
        return np.vstack([np.zeros((1, followed.shape[1])), followed])


def _terms(place: float) -> Array:
    """What the coefficients belong to."""
    return np.array([1.0, 0.0, 0.0] if isnan(place) else [1.0, sin(place), cos(place)])
