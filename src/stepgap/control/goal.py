"""What is wanted of a next state: a measure of its errors, whose sum of squares a command makes small."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from stepgap.step import Array, StepSpace

CAUTION = 2.0
"""Weight of a standard deviation beside an error. With 1, squares add up to the expected squared error; but the least
of many uncertain predictions is low partly by chance, and far from all that was tried the model itself is in doubt."""


class Goal(ABC):
    """A measure of next states: a linear function of their distance from one, whose square is to be small."""

    @abstractmethod
    def errors(self, next_state: Array) -> Array:
        """Scaled errors; (…, n) to (…, r)."""

    @abstractmethod
    def errors_by(self, derivatives: Array) -> Array:
        """Their derivatives, from those of the next state; (n, k) to (r, k)."""

    @abstractmethod
    def spread(self, std: Array) -> Array:
        """Numbers whose squares add up to what independent deviations add to the cautious cost.

        That is `CAUTION`² times what they add to the expected squared error.

        Args:
            std: Standard deviations of the next state, or derivatives of them; shape (n, …).

        Returns:
            Shape (r, …).
        """


@final
@dataclass(frozen=True, eq=False)
class Targets(Goal):
    """The next state is a target, in the coordinates that are tracked and have one.

    Attributes:
        space: State and command.
        target: NaN in coordinates without a target; shape (n,).
    """

    space: StepSpace
    target: Array

    @property
    def wanted(self) -> NDArray[np.bool_]:
        """In which coordinates something is wanted; shape (n,)."""
        return self.space.has_target(self.target)

    def errors(self, next_state: Array) -> Array:
        """Distances from the target in units of `StepSpace.error_scale`; (…, n) to (…, r)."""
        return ((next_state - self.target) / self.space.error_scale)[..., self.wanted]

    def errors_by(self, derivatives: Array) -> Array:
        """Derivatives in the same units; (n, k) to (r, k)."""
        return (derivatives.T / self.space.error_scale).T[self.wanted]

    def spread(self, std: Array) -> Array:
        """`CAUTION` times the deviations in the same units; (n, …) to (r, …)."""
        return CAUTION * self.errors_by(std)
