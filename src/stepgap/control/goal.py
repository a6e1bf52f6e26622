"""What is wanted of a next state: a quadratic form of its distance from one, which a command makes small.

Where all states are tracked, a step is good if its next state is the target: `Targets`. Where some are not, that is not
enough: a robot that moves to the left by its velocity reaches a place at once if it may arrive there with any velocity,
and then has to come back, again and again. What counts there are the errors of all later steps as well. About a state
that a command repeats these are a quadratic form of the next state, the cost-to-go of the linear-quadratic regulator
(R. E. Kalman, 1960), which takes the place of the sum of squared errors: `Deviation`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from stepgap.control.reach import whole_state
from stepgap.step import Array, StepMap, StepSpace

CAUTION = 2.0
"""Weight of a standard deviation beside an error. With 1, squares add up to the expected squared error; but the least
of many uncertain predictions is low partly by chance, and far from all that was tried the model itself is in doubt."""

UNTRACKED_WEIGHT: Final = 0.03
"""Weight of the squared deviation [half ranges] of a coordinate that is not tracked from the state that repeats."""

EFFORT_WEIGHT: Final = 0.01
"""Weight of the squared deviation [half bounds] of a later command from the one that holds that state."""

ToStanding = Callable[[StepMap], StepMap]

LATER_STEPS: Final = 50
"""Number of later steps whose errors count. A finite number needs no stabilising command, and no command moves some
states, such as the heading of a robot with a round foot."""


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


def goals_for(
    step_map: StepMap, targets: Array, untracked: Array | float = UNTRACKED_WEIGHT, standing: ToStanding | None = None
) -> StepGoals:
    """What is wanted of steps to targets: the targets where all states are tracked, otherwise the least cost.

    Args:
        step_map: Predicts steps; where it does not about a target, that is wanted without later costs.
        targets: NaN in coordinates without a target; shape (k, n).
        untracked: Weight of the squared deviation [half ranges] of coordinates without a target; shape (n,).
        standing: Makes of the map that of a command which was the same in the step before, where that is a state.
    """
    space = step_map.space
    goals = dict[bytes, tuple[Goal, Goal]]()  # of each distinct target
    for target in targets:
        if target.tobytes() not in goals:
            plain = Targets(space, target)
            tracked = space.tracked.all()
            regulated = (plain, plain) if tracked else _regulated(step_map, plain, untracked, standing)
            goals[target.tobytes()] = regulated
    alone, onward = zip(*(goals[target.tobytes()] for target in targets), strict=True)
    return StepGoals(alone, onward)


def _regulated(
    step_map: StepMap, plain: Targets, untracked: Array | float, standing: ToStanding | None
) -> tuple[Goal, Goal]:
    """The cost of a step alone and its cost-to-go, about a state that has the values of a target and repeats itself."""
    space = step_map.space
    if standing is None:
        state, command = whole_state(step_map, plain.target)
    else:
        alone = standing(step_map)
        state, command = whole_state(alone, plain.target[: len(alone.space.state)])
        state = np.append(state, command)
    matrix = step_map.jacobian(state, command)
    n = len(space.state)
    if not np.isfinite(matrix).all():
        return plain, plain
    by_state = matrix[:, :n] * space.state_scale / space.state_scale[:, None]
    by_command = matrix[:, n:] * space.command_scale / space.state_scale[:, None]
    weights = np.where(plain.wanted, (space.state_scale / space.error_scale) ** 2, untracked)
    form = _cost_to_go(by_state, by_command, np.diag(weights))
    roots = np.diag(np.sqrt(weights)), np.linalg.cholesky(form).T
    return Deviation(state, roots[0] / space.state_scale), Deviation(state, roots[1] / space.state_scale)


def _cost_to_go(by_state: Array, by_command: Array, weights: Array) -> Array:
    """Solves the Riccati equation of the linear-quadratic regulator backwards from the last step; shape (n, n)."""
    form = weights
    effort = EFFORT_WEIGHT * np.eye(by_command.shape[1])
    for _ in range(LATER_STEPS):
        to_command = by_command.T @ form
        gain = np.linalg.solve(effort + to_command @ by_command, to_command @ by_state)
        form = weights + by_state.T @ form @ (by_state - by_command @ gain)
        form = 0.5 * (form + form.T)
    return form
