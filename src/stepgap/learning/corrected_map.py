"""The nominal map plus a learned residual, which is a `StepMap` again."""

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.learning.disturbance import Disturbance
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
        disturbance: Estimated disturbance of the next step, which is added, too; None for none.
    """

    nominal: StepMap
    residual: Residual
    disturbance: Disturbance | None = None

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
        points = self._points(state, command)
        added = self.disturbance.mean(self._inputs(points)) if self.disturbance else 0.0
        return Outcome(next_state + self.residual.mean(points) + added, status)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n, n + m). NaN where a step fails."""
        added = self.disturbance.slopes / self._half_ranges if self.disturbance else 0.0
        of_residual = self.residual.mean_gradient(self._points(state, command))
        return self.nominal.jacobian(state, command) + self._acting * of_residual + self._acting * added

    @property
    def noise_std(self) -> Array:
        """Standard deviation of a measured next state about its expected value, from the residual; shape (n,)."""
        return self.residual.noise_std

    def std(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Standard deviation of the next state, residual and disturbance; shape (…, n) [units of the state]."""
        points = self._points(state, command)
        std = self.residual.std(points)
        return np.hypot(std, self.disturbance.std(self._inputs(points))) if self.disturbance else std

    def std_gradient(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂std/∂(state, command); shape (…, n, n + m)."""
        points = self._points(state, command)
        gradient = self._acting * self.residual.std_gradient(points)
        if not self.disturbance:
            return gradient
        inputs, std = self._inputs(points), self.residual.std(points)
        added = self.disturbance.std(inputs)
        total = np.hypot(std, added)
        shares = [np.divide(part, total, out=np.ones_like(total), where=total > 0) for part in (std, added)]
        of_added = self._acting * self.disturbance.std_gradient(inputs) / self._half_ranges
        return shares[0][..., None] * gradient + shares[1][..., None] * of_added

    @cached_property
    def _acting(self) -> Array:
        """1 for each state and command coordinate that has an effect, 0 for distances that begin at zero; (n + m,)."""
        return np.append(np.where(self.space.adds_up, 0.0, 1.0), np.ones(len(self.space.command)))

    def _points(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Points at which the residual is learned: distances begin at zero with each step; shape (…, n + m)."""
        return join_points(self.space.onward(np.asarray(state, float)), command)

    @property
    def _half_ranges(self) -> Array:
        """Half ranges of use of state and command; shape (n + m,)."""
        return np.concatenate([self.space.state_scale, self.space.command_scale])

    def _inputs(self, points: Array) -> Array:
        """States and commands from the middle of their ranges on [half ranges]; shape (…, n + m)."""
        centre = np.concatenate([self.space.state_centre, self.space.command_centre])
        return (points - centre) / self._half_ranges
