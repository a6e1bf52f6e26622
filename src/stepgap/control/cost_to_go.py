"""Cost-to-go: what is wanted of a next state where states are not tracked.

Where all states are tracked, a step is good if its next state is the target. Where some are not, that is not enough: a
robot that moves to the left by its velocity reaches a place at once if it may arrive there with any velocity, and then
has to come back, again and again. What counts there are the errors of all later steps as well. About a state that a
command repeats these are a quadratic form of the next state, the cost-to-go of the linear-quadratic regulator (R. E.
Kalman, 1960), which takes the place of the sum of squared errors.
"""

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from stepgap.control.goal import CAUTION, Goal, Targets
from stepgap.control.reach import whole_state
from stepgap.step import Array, StepMap

UNTRACKED_WEIGHT: Final = 0.03
"""Weight of the squared deviation [half ranges] of a coordinate that is not tracked from the state that repeats."""

EFFORT_WEIGHT: Final = 0.01
"""Weight of the squared deviation [half bounds] of a later command from the one that holds that state."""

LATER_STEPS: Final = 50
"""Number of later steps whose errors count. A finite number needs no stabilising command, and no command moves some
states, such as the heading of a robot with a round foot."""


@final
@dataclass(frozen=True, eq=False)
class Deviation(Goal):
    """The next state is near one that a command repeats: a quadratic form of the deviation is small.

    Attributes:
        state: That state; shape (n,).
        root: A square root of the form, root' root; shape (n, n).
    """

    state: Array
    root: Array

    def errors(self, next_state: Array) -> Array:
        """Root times deviation; shape (…, n)."""
        return (next_state - self.state) @ self.root.T

    def errors_by(self, derivatives: Array) -> Array:
        """Root times derivatives; shape (n, k)."""
        return self.root @ derivatives

    def spread(self, std: Array) -> Array:
        """`CAUTION` times the deviations, times the norms of the columns of the root; shape (n, …)."""
        return CAUTION * (std.T * np.linalg.norm(self.root, axis=0)).T


@dataclass(frozen=True, eq=False)
class StepGoals:
    """What is wanted of steps to targets, one after the other.

    Attributes:
        alone: Of each step alone; k goals.
        onward: Of each step and of all steps after it that have the same target; k goals.
    """

    alone: tuple[Goal, ...]
    onward: tuple[Goal, ...]

    @property
    def together(self) -> tuple[Goal, ...]:
        """Of all steps together: each alone, but the last one with all that come after it."""
        return *self.alone[:-1], self.onward[-1]


def goals_for(step_map: StepMap, targets: Array) -> StepGoals:
    """What is wanted of steps to targets: the targets where all states are tracked, otherwise the least cost.

    Args:
        step_map: Predicts steps; where it does not about a target, that is wanted without later costs.
        targets: NaN in coordinates without a target; shape (k, n).
    """
    space = step_map.space
    found = dict[bytes, tuple[Goal, Goal]]()
    for target in targets:
        if target.tobytes() not in found:
            plain = Targets(space, target)
            found[target.tobytes()] = (plain, plain) if space.tracked.all() else _regulated(step_map, plain)
    alone, onward = zip(*(found[target.tobytes()] for target in targets), strict=True)
    return StepGoals(alone, onward)


def _regulated(step_map: StepMap, plain: Targets) -> tuple[Goal, Goal]:
    """The cost of a step alone and its cost-to-go, about a state that has the values of a target and repeats itself."""
    space = step_map.space
    state, command = whole_state(step_map, plain.target)
    matrix, n = step_map.jacobian(state, command), len(space.state)
    if not np.isfinite(matrix).all():
        return plain, plain
    by_state = matrix[:, :n] * space.state_scale / space.state_scale[:, None]
    by_command = matrix[:, n:] * space.command_scale / space.state_scale[:, None]
    weights = np.where(plain.wanted, (space.state_scale / space.error_scale) ** 2, UNTRACKED_WEIGHT)
    form = _cost_to_go(by_state, by_command, np.diag(weights))
    roots = np.diag(np.sqrt(weights)), np.linalg.cholesky(form).T
    return Deviation(state, roots[0] / space.state_scale), Deviation(state, roots[1] / space.state_scale)


def _cost_to_go(by_state: Array, by_command: Array, weights: Array) -> Array:
    """Solves the Riccati equation of the linear-quadratic regulator backwards from the last step; shape (n, n)."""
    form, effort = weights, EFFORT_WEIGHT * np.eye(by_command.shape[1])
    for _ in range(LATER_STEPS):
        to_command = by_command.T @ form
        gain = np.linalg.solve(effort + to_command @ by_command, to_command @ by_state)
        form = weights + by_state.T @ form @ (by_state - by_command @ gain)
        form = 0.5 * (form + form.T)
    return form
