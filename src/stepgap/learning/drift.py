"""What changes from hop to hop while the robot hops: an offset that follows what the residual leaves.

A floor or a boom that leans, a motor that warms up or a slack cable shift the next state by something that is no
function of state and command but alike from one hop to the next, or whenever the robot comes round to the same place.
Each coordinate has Kalman filters side by side, some for an offset c₀ that walks at random, some for an offset
c₀ + c₁ sin ψ + c₂ cos ψ at place ψ, each at another rate. The one that has predicted best of late is used, and one that
follows nothing, so that where nothing drifts nothing is added. What a filter does not see for long is forgotten, but
not beyond what it knew at first (Kulhavý's stabilised forgetting).
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

FORGETTING = np.tile(RATES**2, 2)
"""Share by which each filter's covariance returns to the first one in a step; shape (filters,)."""
FIRST = np.array([np.diag(known) for known in ([1.0, 0, 0], [1.0, 1, 1]) for _ in RATES])
"""Covariance at first, in variances of a step's noise: filters that know no place, then those that do."""


@final
@dataclass(frozen=True, eq=False)
class Drift:
    """All filters; immutable.

    Attributes:
        coefficients: c of each filter; shape (filters, 3, n).
        covariance: Of c, in variances of a step's noise; shape (filters, 3, 3).
        scores: Discounted squares of what was missed by following nothing, then by each filter; shape (1 + filters, n).
        weight: Discounted number of steps.
    """

    coefficients: Array
    covariance: Array
    scores: Array
    weight: float = 0.0

    @classmethod
    def none(cls, size: int) -> Self:
        """Before the first step, for n coordinates."""
        return cls(np.zeros((len(FIRST), 3, size)), FIRST, np.zeros((1 + len(FIRST), size)))

    def offset(self, place: float) -> Array:
        """What to add to the predicted state of a step that starts at a place [rad], or at none (NaN); shape (n,)."""
        return self._offsets(_terms(place))[self._best, np.arange(self.scores.shape[1])]

    def std(self, place: float) -> Array:
        """Standard deviation of that offset, in those of a step's noise; shape (n,)."""
        terms = _terms(place)
        return np.sqrt(np.append(0.0, self._walked() @ terms @ terms))[self._best]

    def followed(self, left: Array, place: float) -> "Drift":
        """After a step from a place [rad] of which the map without this offset left an error; shape (n,)."""
        terms, covariance = _terms(place), self._walked()
        missed = left - self._offsets(terms)
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

    def _walked(self) -> Array:
        """Covariances after the walk of one step; shape (filters, 3, 3)."""
        return self.covariance + FORGETTING[:, None, None] * (FIRST - self.covariance)

    def _offsets(self, terms: Array) -> Array:
        """Nothing, then what each filter says; shape (1 + filters, n)."""
        followed = np.einsum("k,fkn->fn", terms, self.coefficients)
        return np.vstack([np.zeros((1, followed.shape[1])), followed])


def _terms(place: float) -> Array:
    """What the coefficients belong to."""
    return np.array([1.0, 0.0, 0.0] if isnan(place) else [1.0, sin(place), cos(place)])
