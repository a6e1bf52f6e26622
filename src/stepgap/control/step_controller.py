"""The step controller: it finds the command whose next apex is the target (Sec. 4.3, Eqs. 11 and 13).

`StepController` works with any `StepMap`, nominal or corrected. A few Gauss–Newton steps within the command bounds
suffice nearly always; where they do not reach the target, a better start is searched on a grid over the bounds.
All points here are scaled: the command bounds are -1 and 1, and errors are divided by half ranges of the state.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stepgap.control.bounded_search import solve
from stepgap.control.gauss_newton import REACHED
from stepgap.step import Array, StepFailed, StepMap, StepStatus


@dataclass(frozen=True, eq=False)
class StepPlan:
    """A command and the prediction of its step.

    Attributes:
        command: Within the bounds; shape (m,).
        predicted: Next state; shape (n,).
        reached: Whether `predicted` is the target.
        distance: Distance from `predicted` to the target: Euclidean, each coordinate divided by half its range of use.
    """

    command: Array
    predicted: Array
    reached: bool
    distance: float


@dataclass(frozen=True)
class StepController:
    """Finds the command whose predicted next state is the target, or comes closest to it.

    Attributes:
        step_map: Predicts steps; it may be nominal or corrected.
    """

    step_map: StepMap

    def __call__(self, state: ArrayLike, target: ArrayLike, guess: ArrayLike | None = None) -> StepPlan:
        """Solves map(state, command) = target within the command bounds (Eqs. 11, 13).

        Args:
            state: State at this apex; shape (n,).
            target: State wanted at the next apex; shape (n,).
            guess: Command to start from, such as the previous one; the middle of the bounds if none. Shape (m,).

        Raises:
            StepFailed: No command that was searched makes a step.
            ValueError: State, target or guess has the wrong size, or the target or guess is not finite.
        """
        space = self.step_map.space
        n, m = len(space.state), len(space.command)
        state_scale, command_at = space.state_scale, space.command_at
        state, target = as_vector("state", state, n), as_vector("target", target, n)
        start = space.command_centre if guess is None else as_vector("guess", guess, m)
        if not np.isfinite(state).all():
            raise StepFailed(StepStatus.INVALID)
        if not (np.isfinite(target).all() and np.isfinite(start).all()):
            raise ValueError(f"target {target} and guess {start} must be finite numbers")

        known: dict[bytes, Array] = {}

        def error(point: Array) -> Array:
            next_state = self.step_map.evaluate(state, command_at(point)).next_state
            if point.ndim == 1:
                known[point.tobytes()] = next_state
            return (next_state - target) / state_scale

        def jacobian(point: Array) -> Array:
            matrix = self.step_map.jacobian(state, command_at(point))[:, n:]
            return matrix * space.command_scale / state_scale[:, None]

        solution = solve(error, jacobian, space.point_of(start), bound=1.0)
        command = command_at(solution.point)
        predicted = known.get(solution.point.tobytes())
        if predicted is None or not np.isfinite(predicted).all():
            predicted = self.step_map(state, command)
        distance = float(np.linalg.norm((predicted - target) / state_scale))
        return StepPlan(command, predicted, distance <= REACHED, distance)


def as_vector(name: str, values: ArrayLike, size: int) -> Array:
    """Converts the values to an array of shape (size,); ValueError if they have another shape."""
    vector = np.asarray(values, float)
    if vector.shape != (size,):
        raise ValueError(f"{name} has shape {vector.shape}; it must be ({size},)")
    return vector
