"""Commands of the step controller on a regular grid over (state, target), interpolated linearly.

A table evaluates no map when it is used, so its cost does not depend on the map.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import RegularGridInterpolator

from stepgap.base.errors import InputError
from stepgap.base.ranges import require
from stepgap.control.box_points import box_grid
from stepgap.control.step_controller import StepController, StepPlan, as_vector
from stepgap.step import Array, StepFailed, StepMap, StepSpace, StepStatus

NEARLY_ONE = 1 - 1e-9
"""The part of the surrounding nodes that must reach their targets: all, but for rounding."""

TableProgress = Callable[[int, int], None]
"""Called with the number of nodes solved and the number of all nodes."""


@dataclass(frozen=True, eq=False)
class CommandTable:
    """Commands of the step controller on an even grid over the range of use of state and target; used like it.

    Attributes:
        space: Names, units and ranges of the map it was built for.
        commands: Within the bounds, NaN where no command makes a step; one axis for each coordinate of the state,
            then of the target, each of equally many points. Shape (points, …, points, m).
        predicted: Next states of these commands; shape (points, …, points, n).
        reached: Whether `predicted` is the target; shape (points, …, points).
    """

    space: StepSpace
    commands: Array
    predicted: Array
    reached: NDArray[np.bool_]

    @cached_property
    def _interpolated(self) -> RegularGridInterpolator:
        """Command, predicted next state and the part of nodes that reach their targets, at (state, target)."""
        axes = np.linspace(self.space.state_lower, self.space.state_upper, len(self.reached), axis=1)
        nodes = np.concatenate([self.commands, self.predicted, self.reached[..., None]], axis=-1)
        return RegularGridInterpolator((*axes, *axes), nodes)

    def __call__(self, state: ArrayLike, target: ArrayLike, guess: ArrayLike | None = None) -> StepPlan:  # noqa: ARG002
        """Interpolates the command for a state and target linearly along each axis.

        Outside the range of use the command is that of the nearest point inside, and counts as not reached. `reached`
        is true if all surrounding nodes reach their targets; near the border of the reachable set it may be false for
        a target that can be reached.

        Args:
            state: State at this section; shape (n,).
            target: State wanted at the next section; shape (n,).
            guess: Unused; it exists so that a table can replace a `StepController`.

        Raises:
            StepFailed: No command makes a step from a surrounding node, or the state is not finite.
            ValueError: State or target has the wrong size, or the target is not finite.
        """
        space = self.space
        n = len(self.space.state)
        m = len(self.space.command)
        state = as_vector("state", state, n)
        target = as_vector("target", target, n)
        if not np.isfinite(state).all():
            raise StepFailed(StepStatus.INVALID, space)
        if not np.isfinite(target).all():
            raise ValueError(f"target {target} must be finite numbers")
        points = np.stack([state, target])
        inside = np.clip(points, space.state_lower, space.state_upper)
        (values,) = self._interpolated(inside.reshape(1, -1))
        if not np.isfinite(values).all():
            raise StepFailed(StepStatus.INVALID, space)
        command, predicted, (part_reached,) = np.split(values, [m, m + n])
        is_inside = (np.abs(points - inside) <= 1e-12 * space.state_scale).all()
        return StepPlan(
            np.clip(command, space.command_lower, space.command_upper),
            predicted,
            bool(is_inside and part_reached >= NEARLY_ONE),
            float(np.linalg.norm((predicted - target) / space.error_scale)),
        )


def build_table(
    step_map: StepMap, points: int = 15, progress: TableProgress = lambda done, total: None
) -> CommandTable:
    """Solves every node of a grid over the range of use of state and target.

    Args:
        step_map: The map to command.
        points: Points along each of the 2n axes, at least 2.
        progress: Called after all nodes of a state.

    Raises:
        ValueError: There are fewer than 2 points.
        InputError: Some state coordinate is not tracked, or has a weight of its own.
    """
    space = step_map.space
    n = len(step_map.space.state)
    m = len(step_map.space.command)
    if others := [quantity.name for quantity in space.state if quantity.weight != 1]:
        raise InputError(
            f"a table of commands needs a weight of 1 of every state coordinate; {others[0]} has another one"
        )
    require(points >= 2, "points", points, "be at least 2: both ends of each axis")
    states = (space.state_lower + space.state_scale * (1 + box_grid(points, n))).reshape(-1, n)
    count = len(states)
    commands = np.full((count, count, m), np.nan)
    predicted = np.full((count, count, n), np.nan)
    reached = np.zeros((count, count), bool)
    controller = StepController(step_map)
    for row, state in enumerate(states):
        guess = None
        for column, target in enumerate(states):
            try:
                plan = controller(state, target, guess)
            except StepFailed:  # no command makes a step from this state, whatever the target
                break
            guess = plan.command
            commands[row, column] = plan.command
            predicted[row, column] = plan.predicted
            reached[row, column] = plan.reached
        progress((row + 1) * count, count**2)
    grid = (points,) * (2 * n)
    return CommandTable(space, commands.reshape(*grid, m), predicted.reshape(*grid, n), reached.reshape(grid))
