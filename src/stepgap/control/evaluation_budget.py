"""A budget of evaluations for the choice of one command, so that it ends in time on a slow map."""

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.control.wrapped_map import WrappedMap
from stepgap.step import Array, Outcome, StepSpace, StepStatus


@dataclass(eq=False)
class EvaluationBudget:
    """Number of steps that the maps of one search may still evaluate together.

    Attributes:
        remaining: Number of steps.
    """

    remaining: int

    def spend(self, steps: int) -> bool:
        """Takes a number of steps from the budget; returns whether they were in it, and takes none if not."""
        granted = steps <= self.remaining
        self.remaining -= steps if granted else 0
        return granted


@final
@dataclass(frozen=True, eq=False)
class BudgetedMap(WrappedMap):
    """A map whose steps fail once the budget is spent.

    A search treats such a step like any other that fails, and returns the best command found before. A Jacobian counts
    as the 2 (n + m) steps of its central differences, also where there is a formula for it.

    Attributes:
        budget: Number of steps that it may still evaluate.
    """

    budget: EvaluationBudget

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges of the map."""
        return self.inner.space

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes; all fail as `StepStatus.INVALID` if they are more than the budget permits."""
        leading = self._leading(state, command)
        if self.budget.spend(int(np.prod(leading))):
            return self.inner.evaluate(state, command)
        n = len(self.space.state)
        return Outcome(np.full((*leading, n), np.nan), np.full(leading, int(StepStatus.INVALID)))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n, n + m). NaN where a step fails or the budget is spent."""
        leading, n = self._leading(state, command), len(self.space.state)
        inputs = n + len(self.space.command)
        if self.budget.spend(2 * inputs * int(np.prod(leading))):
            return self.inner.jacobian(state, command)
        return np.full((*leading, n, inputs), np.nan)

    @staticmethod
    def _leading(state: ArrayLike, command: ArrayLike) -> tuple[int, ...]:
        """Shape of the batch."""
        return np.broadcast_shapes(np.shape(state)[:-1], np.shape(command)[:-1])
