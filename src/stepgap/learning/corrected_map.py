"""The nominal map plus a learned residual, which is a `StepMap` again."""

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.learning.residual import Residual, join_points
from stepgap.step import Array, Outcome, StepMap, StepSpace


@final
@dataclass(frozen=True, eq=False)
class CorrectedMap(StepMap):
    """Nominal map plus residual (Eq. 13).

    A step that fails on the nominal map fails here, with the same status.

    Attributes:
        nominal: The map of the physics model. Not a corrected one: a residual is fitted to
            actual − nominal on all steps, so corrections never stack.
        residual: Model of actual − nominal, of the same sizes.
        offset: Estimated disturbance of the next step, which is added, too; shape (n,), or 0.
        offset_std: Standard deviation of the offset [units of the state]; shape (n,), or 0.
    """

    nominal: StepMap
    residual: Residual
    offset: Array | float = 0.0
    offset_std: Array | float = 0.0

    def __post_init__(self) -> None:
        if isinstance(self.nominal, CorrectedMap):
            raise ValueError("corrections do not stack; fit one residual to actual − nominal on all steps")
        sizes = (len(self.space.state), len(self.space.command))
        if self.residual.sizes != sizes:
            raise ValueError(f"the residual has (state, command) sizes {self.residual.sizes}, the nominal map {sizes}")

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges of the nominal map."""
        return self.nominal.space

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes; never raises for a step that fails."""
        next_state, status = self.nominal.evaluate(state, command)
        return Outcome(next_state + self.residual.mean(join_points(state, command)) + self.offset, status)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n, n + m). NaN where a step fails."""
        return self.nominal.jacobian(state, command) + self.residual.mean_gradient(join_points(state, command))

    @property
    def noise_std(self) -> Array:
        """Standard deviation of a measured next state about its expected value, from the residual; shape (n,)."""
        return self.residual.noise_std

    def std(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Standard deviation of the next state, residual and offset; shape (…, n) [units of the state]."""
        return np.hypot(self.residual.std(join_points(state, command)), self.offset_std)

    def std_gradient(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂std/∂(state, command); shape (…, n, n + m)."""
        points = join_points(state, command)
        std = self.residual.std(points)
        total = np.hypot(std, self.offset_std)
        share = np.divide(std, total, out=np.ones_like(total), where=total > 0)
        return share[..., None] * self.residual.std_gradient(points)
