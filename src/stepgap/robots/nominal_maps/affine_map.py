"""An affine map: a template of a few numbers, or another map linearised at a point."""

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.learning.residual import join_points
from stepgap.step import Array, Outcome, StepMap, StepSpace, StepStatus


@final
@dataclass(frozen=True, eq=False)
class AffineMap(StepMap):
    """next = next₀ + J (x − x₀, u − u₀); a step with finite numbers never fails.

    Attributes:
        quantities: Names, units and ranges.
        state: x₀; shape (n,).
        command: u₀; shape (m,).
        next_state: next₀; shape (n,).
        matrix: J; shape (n, n + m).
    """

    quantities: StepSpace
    state: Array
    command: Array
    next_state: Array
    matrix: Array

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self.quantities

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states, and status codes OK, or INVALID where a number is not finite."""
        points = join_points(state, command)
        next_state = self.next_state + (points - join_points(self.state, self.command)) @ self.matrix.T
        missing = _missing(points)
        status = np.where(np.isnan(missing), int(StepStatus.INVALID), int(StepStatus.OK))
        return Outcome(next_state + missing[..., None], status)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """J; shape (…, n, n + m). NaN where a number is not finite."""
        return self.matrix + _missing(join_points(state, command))[..., None, None]


def _missing(points: Array) -> Array:
    """0 for each point that is finite, otherwise NaN; (…, k) to (…)."""
    return np.where(np.isfinite(points).all(axis=-1), 0.0, np.nan)
