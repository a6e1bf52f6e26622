"""The nominal map plus a learned residual, which is a `StepMap` again."""

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.learning.residual import Residual, join_points
from stepgap.step import Array, CommandBefore, Outcome, StepMap, StepSpace


@final
@dataclass(frozen=True, eq=False, repr=False)
class CorrectedMap(StepMap):
    """Nominal map plus residual (Eq. 13).

    A step that fails on the nominal map fails here, with the same status.

    Attributes:
        nominal: The map of the physics model. Not a corrected one: a residual is fitted to
            actual − nominal on all steps, so corrections never stack.
        residual: Model of actual − nominal, of the same sizes.
        offset: Measured minus true state at the start of the next step, as far as it is known; None for none.
        before: The effect of the command of the step before, which is in the residual; None for none.
    """

    nominal: StepMap
    residual: Residual
    offset: Array | None = None
    before: CommandBefore | None = None

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
        next_state, status = self.nominal.evaluate(self._true(state), command)
        points = self._points(state, command)
        return Outcome(next_state + self.residual.mean(points), status)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n, n + m). NaN where a step fails."""
        of_residual = self.residual.mean_gradient(self._points(state, command))
        return self.nominal.jacobian(self._true(state), command) + self._acting * of_residual

    @property
    def command_before(self) -> CommandBefore | None:
        """The effect of the command of the step before; None if it has none, or is not known."""
        return self.before

    @property
    def noise_std(self) -> Array:
        """Standard deviation of a measured next state about its expected value, from the residual; shape (n,)."""
        return self.residual.noise_std

    def std(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Standard deviation of the next state, without noise; shape (…, n) [units of the state]."""
        return self.residual.std(self._points(state, command))

    def std_gradient(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂std/∂(state, command); shape (…, n, n + m)."""
        return self._acting * self.residual.std_gradient(self._points(state, command))

    def _true(self, state: ArrayLike) -> Array:
        """Measured states less their offset."""
        state = np.asarray(state, float)
        return state if self.offset is None else state - self.offset

    @cached_property
    def _acting(self) -> Array:
        """1 for each state and command coordinate that has an effect, 0 for distances that begin at zero; (n + m,)."""
        return np.append(np.where(self.space.adds_up, 0.0, 1.0), np.ones(len(self.space.command)))

    def _points(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Points at which the residual is learned: distances begin at zero with each step; shape (…, n + m)."""
        return join_points(self.space.onward(self._true(state)), command)
