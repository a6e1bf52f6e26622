"""The step controller: the command with which the next state is the target (Sec. 4.3 of the paper, Eqs. 11, 13).

`StepController` works with any `StepMap`, nominal or corrected. Usually a few damped Gauss–Newton steps within the
command bounds reach the target. Where they do not, the controller searches all over the bounds for better starting
points (`bounded_search`). In a run, `DeploymentController` (`experiment.deployment`) calls `CautiousController`, which
calls this controller, and departs from its command where the map is uncertain or a fall is possible.

The search works on scaled quantities: a *point* is a command scaled so that its bounds are -1 and 1, and errors of the
state are divided by half the range of each coordinate over the root of its weight (`StepSpace.error_scale`). Where
nothing is wanted of a coordinate, its target is NaN. Of several commands that reach a target, the search finds one near
its start.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stepgap.control.bounded_search import bounded_solution
from stepgap.control.gauss_newton import REACHED
from stepgap.control.goal import Goal, Targets
from stepgap.step import Array, StepFailed, StepMap, StepSpace, StepStatus


@dataclass(frozen=True, eq=False)
class StepPlan:
    """A command and the step that the map predicts for it.

    Attributes:
        command: Command within the bounds; shape (m,).
        predicted: Predicted next state; shape (n,).
        reached: Whether `predicted` is the target: `distance` is at most `gauss_newton.REACHED`, 1e-6.
        distance: Root of the sum of squared errors of `predicted`: to a target, its Euclidean distance, each coordinate
            divided by half its range over the root of its weight.
    """

    command: Array
    predicted: Array
    reached: bool
    distance: float


@dataclass(frozen=True)
class StepController:
    """Finds the command whose predicted next state is the target, or the closest state that the search finds.

    Attributes:
        step_map: Map that predicts steps, nominal or corrected.
    """

    step_map: StepMap

    def __call__(self, state: ArrayLike, target: ArrayLike, guess: ArrayLike | None = None) -> StepPlan:
        """Solves map(state, command) = target within the command bounds (Eqs. 11, 13).

        Args:
            state: State at this section; shape (n,).
            target: State wanted at the next section, NaN in coordinates without a target; shape (n,).
            guess: Command at which the search starts, such as the previous one; shape (m,). None: the middle of the
                bounds.

        Raises:
            StepFailed: The state is not finite, or the search found no command that leads to a next state.
            ValueError: State, target or guess has the wrong size, a target is infinite, or the guess is not finite.
        """
        space = self.step_map.space
        return self.towards(state, Targets(space, checked_target(space, target)), guess)

    def towards(self, state: ArrayLike, goal: Goal, guess: ArrayLike | None = None) -> StepPlan:
        """Finds the command of least error within the command bounds.

        Args:
            state: State at this section; shape (n,).
            goal: What is wanted of the next state.
            guess: As of a call.

        Raises:
            StepFailed: As of a call.
            ValueError: State or guess has the wrong size, or the guess is not finite.
        """
        space = self.step_map.space
        n = len(space.state)
        m = len(space.command)
        command_at = space.command_at
        state = as_vector("state", state, n)
        start = space.command_centre if guess is None else as_vector("guess", guess, m)
        if not np.isfinite(state).all():
            raise StepFailed(StepStatus.INVALID, space)
        if not np.isfinite(start).all():
            raise ValueError(f"guess {start} must be finite numbers")

        next_states: dict[bytes, Array] = {}  # by point, so that the solution is not evaluated again

        def error(point: Array) -> Array:
            """Errors at points (…, m); shape (…, r). Keeps the next states."""
            ends = self.step_map.evaluate(state, command_at(point)).next_state
            pairs = zip(point.reshape(-1, m), ends.reshape(-1, n), strict=True)
            next_states.update((at.tobytes(), next_state) for at, next_state in pairs if np.isfinite(next_state).all())
            return goal.errors(ends)

        def jacobian(point: Array) -> Array:
            """∂error/∂point; shape (r, m)."""
            return goal.errors_by(self.step_map.jacobian(state, command_at(point))[:, n:] * space.command_scale)

        solution = bounded_solution(error, jacobian, space.point_of(start))
        command = command_at(solution.point)
        predicted = next_states.get(solution.point.tobytes())
        if predicted is None:
            predicted = self.step_map(state, command)
        distance = float(np.linalg.norm(goal.errors(predicted)))
        return StepPlan(command, predicted, distance <= REACHED, distance)


def checked_target(space: StepSpace, target: ArrayLike) -> Array:
    """The target as an array of shape (n,); raises ValueError if it has another shape, or an infinite number."""
    target = as_vector("target", target, len(space.state))
    if np.isinf(target).any():
        raise ValueError(f"target {target} must be finite numbers, or NaN for no target")
    return target


def as_vector(name: str, values: ArrayLike, size: int) -> Array:
    """The values as an array of shape (size,); raises ValueError if their shape is another one."""
    vector = np.asarray(values, float)
    if vector.shape != (size,):
        raise ValueError(f"{name} has shape {vector.shape}; it must be ({size},)")
    return vector
