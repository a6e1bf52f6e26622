"""What changes from hop to hop while the robot hops: an offset that follows what the residual leaves.

A floor that leans, a motor that warms up or a slack cable shift the next state by something that is alike from one hop
to the next and no function of state and command. Each coordinate has filters of several gains side by side, exponential
means of what was left; the one that has predicted best of late is used. One of the gains is zero, so that where nothing
drifts nothing is followed.
"""

from dataclasses import dataclass, replace
from typing import Self, final

import numpy as np

from stepgap.step import Array

GAINS = np.array([0.0, 0.05, 0.1, 0.2, 0.4])
"""Share of what it missed by which a filter moves at every step."""
REMEMBERED = 0.98
"""Weight of a filter's score from one step to the next: about the last 50 steps count."""
RELUCTANCE = 5.0
"""Steps' worth of typical squares by which a gain must have been better before the first one, zero, is left."""


@final
@dataclass(frozen=True, eq=False)
class Drift:
    """Offsets by filters of all gains; immutable.

    Attributes:
        offsets: Shape (gains, n).
        scores: Discounted squares of what each missed; shape (gains, n).
        weight: Discounted number of steps.
    """

    offsets: Array
    scores: Array
    weight: float = 0.0

    @classmethod
    def none(cls, size: int) -> Self:
        """Before the first step, for n coordinates."""
        return cls(np.zeros((len(GAINS), size)), np.zeros((len(GAINS), size)))

    @property
    def offset(self) -> Array:
        """What to add to the predicted state; shape (n,)."""
        typical = self.scores[0] / max(self.weight, 1.0)
        handicap = np.where(GAINS > 0, 1.0, 0.0)[:, None] * RELUCTANCE * typical
        best = np.argmin(self.scores + handicap, axis=0)
        return self.offsets[best, np.arange(self.offsets.shape[1])]

    def followed(self, left: Array) -> "Drift":
        """After a step of which the map without this offset left an error; shape (n,)."""
        missed = left - self.offsets
        return replace(
            self,
            offsets=self.offsets + GAINS[:, None] * missed,
            scores=REMEMBERED * self.scores + missed**2,
            weight=REMEMBERED * self.weight + 1.0,
        )
