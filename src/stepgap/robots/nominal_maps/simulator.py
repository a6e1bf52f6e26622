"""A simulator as a step map: any program that moves a robot tick by tick, or computes a whole step."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.learning.residual import join_points
from stepgap.step import Array, Outcome, StepMap, StepSpace, StepStatus, difference_jacobian

Step = Callable[[Array, Array], Array | StepStatus]
"""Computes a step from its state (n,) and command (m,): the next state (n,), or how it failed."""


@final
@dataclass(frozen=True)
class Simulator:
    """A step of a robot that is simulated tick by tick; itself a `Step`.

    Attributes:
        reset: Puts the robot into a state at the section and gives it a command for the step that begins.
        tick: Advances the simulation by one tick.
        section: Called after every tick. Returns the state once the robot has come to the section again, a status if
            the step failed, and None otherwise.
        most_ticks: Number of ticks after which a step has failed (`StepStatus.NO_APEX`).
    """

    reset: Callable[[Array, Array], None]
    tick: Callable[[], None]
    section: Callable[[], Array | StepStatus | None]
    most_ticks: int = 5000

    def __call__(self, state: Array, command: Array) -> Array | StepStatus:
        """Simulates one step."""
        self.reset(state, command)
        for _ in range(self.most_ticks):
            self.tick()
            end = self.section()
            if end is not None:
                return end
        return StepStatus.NO_APEX


@final
@dataclass(frozen=True, eq=False, repr=False)
class SimulatorMap(StepMap):
    """The steps of a simulator.

    Every evaluation is a simulation, and a Jacobian takes two for each coordinate. A controller needs some hundred for
    each command, so usually a `SurrogateMap` is fitted to it.

    Attributes:
        quantities: Names, units and ranges.
        step: Computes a step.
        relative_step: Step of the differences for the Jacobian, in half ranges (`differenced_map.suitable_step`).
    """

    quantities: StepSpace
    step: Step
    relative_step: float = 1e-2

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self.quantities

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Simulates each step; one with numbers that are not finite is INVALID, and has no next state."""
        points = join_points(state, command)
        n = len(self.space.state)
        next_state = np.full((*points.shape[:-1], n), np.nan)
        status = np.full(points.shape[:-1], int(StepStatus.INVALID), np.int64)
        for index in np.ndindex(status.shape):
            point = points[index]
            if np.isfinite(point).all():
                next_state[index], status[index] = self._simulated(point[:n], point[n:])
        return Outcome(next_state, status)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Central differences; shape (…, n, n + m). NaN where a step fails."""
        return difference_jacobian(self, state, command, self.relative_step)

    def _simulated(self, state: Array, command: Array) -> tuple[Array | float, int]:
        end = self.step(state.copy(), command.copy())
        if isinstance(end, StepStatus):
            return np.nan, int(end)
        next_state = np.asarray(end, float)
        if next_state.shape != state.shape:
            raise ValueError(f"the simulator returned a state of shape {next_state.shape} instead of {state.shape}")
        if not np.isfinite(next_state).all():
            return np.nan, int(StepStatus.NO_APEX)
        return next_state, int(StepStatus.OK)
