"""Commands of the step controller on a regular grid over (state, target), interpolated.

A table evaluates no map when it is used, so its cost does not depend on the map. `measure_table` measures the error
of interpolation: it compares interpolated commands with solved ones at random points.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepgap.base.errors import InputError
from stepgap.base.ranges import require
from stepgap.control.box_points import box_grid
from stepgap.control.solve_many import Answers, solve_many
from stepgap.control.step_controller import StepPlan, as_vector
from stepgap.step import Array, Codes, StepFailed, StepMap, StepSpace, StepStatus

BATCH = 4096
"""Approximate number of nodes that are solved together; at least those of one state."""

TableProgress = Callable[[int, int], None]
"""Called with the number of nodes solved and the number of all nodes."""


@dataclass(frozen=True, eq=False)
class CommandTable:
    """Commands of the step controller on an even grid over the range of use of state and target; used like it.

    Attributes:
        space: Names, units and ranges of the map it was built for.
        commands: Within the bounds, NaN where no command makes a step; one axis for each coordinate of the state,
            then of the target, each of `points` points. Shape (points, …, points, m).
        predicted: Next state of these commands; shape (points, …, points, n).
        reached: Whether `predicted` is the target; shape (points, …, points).
        statuses: Why no command makes a step, else OK; shape (points, …, points).
    """

    space: StepSpace
    commands: Array
    predicted: Array
    reached: NDArray[np.bool_]
    statuses: Codes

    def __post_init__(self) -> None:
        n, m = len(self.space.state), len(self.space.command)
        grid = self.reached.shape
        if len(grid) != 2 * n or len(set(grid)) != 1 or grid[0] < 2:
            raise ValueError(f"the grid has shape {grid}; it must be {2 * n} axes of equally many points, at least 2")
        wanted = {"commands": (*grid, m), "predicted": (*grid, n), "statuses": grid}
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}; it must be {shape}")
        if not np.isin(self.statuses, list(StepStatus)).all():
            raise ValueError("statuses must be values of StepStatus")
        works = self.statuses == StepStatus.OK
        if not (np.isfinite(self.commands[works]).all() and np.isfinite(self.predicted[works]).all()):
            raise ValueError("commands and predicted must be finite numbers where a step is made")
        if not _within(self.commands[works], self.space) or (self.reached & ~works).any():
            raise ValueError("commands must lie within their bounds, and reached nodes must have a step")

    @property
    def points(self) -> int:
        """Points along each axis."""
        return self.reached.shape[0]

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
        n = len(self.space.state)
        state, target = as_vector("state", state, n), as_vector("target", target, n)
        if not np.isfinite(state).all():
            raise StepFailed(StepStatus.INVALID, self.space)
        if not np.isfinite(target).all():
            raise ValueError(f"target {target} must be finite numbers")
        found = self.interpolate(state, target)
        if found.status != StepStatus.OK:
            raise StepFailed(StepStatus(int(found.status)), self.space)
        distance = float(np.linalg.norm((found.predicted - target) / self.space.error_scale))
        return StepPlan(found.command, found.predicted, bool(found.reached), distance)

    def interpolate(self, states: ArrayLike, targets: ArrayLike) -> Answers:
        """Interpolates many commands at once, without exceptions; states and targets (…, n) broadcast."""
        points = np.concatenate(np.broadcast_arrays(np.asarray(states, float), np.asarray(targets, float)), axis=-1)
        lower = np.tile(self.space.state_lower, 2)
        index = (points - lower) / np.tile(2 * self.space.state_scale, 2) * (self.points - 1)
        inside = (np.abs(index - (self.points - 1) / 2) <= (self.points - 1) / 2 * (1 + 1e-12)).all(axis=-1)
        index = np.clip(index, 0, self.points - 1)
        index = np.where(np.abs(index - np.rint(index)) < 1e-9, np.rint(index), index)  # at a node only it has weight
        corner = np.minimum(index.astype(int), self.points - 2)
        node, weight = _corners(index - corner, corner, self.points)
        used = weight > 0

        def mean(values: Array) -> Array:
            terms = weight[..., None] * values.reshape(-1, values.shape[-1])[node]
            return np.where(used[..., None], terms, 0.0).sum(axis=-2)

        command = np.clip(mean(self.commands), self.space.command_lower, self.space.command_upper)
        status = np.where(used, self.statuses.reshape(-1)[node], 0).max(axis=-1)
        command = np.where((status == StepStatus.OK)[..., None], command, np.nan)
        reached = inside & np.all(self.reached.reshape(-1)[node] | ~used, axis=-1)
        return Answers(command, mean(self.predicted), reached, status)


def _corners(offset: Array, corner: NDArray[np.int64], points: int) -> tuple[NDArray[np.int64], Array]:
    """Indices and weights of the 2ᵈ nodes around a point at an offset (…, d) from a cell's lowest corner; (…, 2ᵈ)."""
    d = offset.shape[-1]
    sides = np.array(list(product((0, 1), repeat=d)))
    strides = points ** np.arange(d - 1, -1, -1)
    weight = np.where(sides == 1, offset[..., None, :], 1 - offset[..., None, :]).prod(axis=-1)
    return (corner @ strides)[..., None] + sides @ strides, weight


def _within(commands: Array, space: StepSpace) -> bool:
    return bool(((commands >= space.command_lower) & (commands <= space.command_upper)).all())


def build_table(
    step_map: StepMap, points: int = 15, progress: TableProgress = lambda done, total: None
) -> CommandTable:
    """Solves every node of a grid over the range of use of state and target.

    Args:
        step_map: The map to command.
        points: Points along each of the 2n axes, at least 2.
        progress: Called after every batch.

    Raises:
        ValueError: There are fewer than 2 points.
        InputError: Some state coordinate is not tracked, or has a weight of its own.
    """
    if others := [quantity.name for quantity in step_map.space.state if quantity.weight != 1]:
        raise InputError(
            f"a table of commands needs a weight of 1 of every state coordinate; {others[0]} has another one"
        )
    require(points >= 2, "points", points, "be at least 2: both ends of each axis")
    space, n = step_map.space, len(step_map.space.state)
    states = (space.state_lower + space.state_scale * (1 + box_grid(points, n))).reshape(-1, n)
    answers, done = [], 0
    for batch in np.array_split(states, min(len(states), max(1, len(states) ** 2 // BATCH))):
        answers.append(solve_many(step_map, batch, states))
        done += answers[-1].status.size
        progress(done, len(states) ** 2)
    grid = (points,) * (2 * n)
    return CommandTable(
        space,
        np.concatenate([answer.command for answer in answers]).reshape(*grid, len(space.command)),
        np.concatenate([answer.predicted for answer in answers]).reshape(*grid, n),
        np.concatenate([answer.reached for answer in answers]).reshape(grid),
        np.concatenate([answer.status for answer in answers]).reshape(grid),
    )


@dataclass(frozen=True, eq=False)
class TableError:
    """Error of interpolation, at random states and targets that solving reaches.

    Attributes:
        samples: Number of points compared that are reached according to the table.
        worst_command: Their largest difference to the solved command; shape (m,).
        worst_state: Their largest difference of the next state to the target; shape (n,).
        median_state: Median of that difference; shape (n,).
        border_samples: Number of points compared in cells of which only some nodes reach their targets.
        border_state: Their largest difference of the next state to the target, NaN if there are none; shape (n,).
    """

    samples: int
    worst_command: Array
    worst_state: Array
    median_state: Array
    border_samples: int
    border_state: Array


def measure_table(table: CommandTable, step_map: StepMap, rng: np.random.Generator, samples: int = 1000) -> TableError:
    """Compares a table with solving, at random states and targets in the range of use.

    Args:
        table: The table.
        step_map: The map it was built from.
        rng: Random generator that draws the points.
        samples: Number of points; those that no command reaches are not counted.

    Raises:
        ValueError: None of the points lies in a cell of which all nodes reach their targets.
    """
    lower = table.space.state_lower
    states, targets = rng.uniform(lower, lower + 2 * table.space.state_scale, (2, samples, len(lower)))
    found, solved = table.interpolate(states, targets), solve_many(step_map, states, targets[:, None])
    inside = found.reached & solved.reached[:, 0]
    border = ~found.reached & solved.reached[:, 0] & (found.status == StepStatus.OK)
    if not inside.any():
        raise ValueError(f"none of {samples} random states and targets is within the table's reach; take more points")
    off = np.abs(step_map.evaluate(states, found.command).next_state - targets)
    return TableError(
        int(inside.sum()),
        np.abs(found.command - solved.command[:, 0])[inside].max(axis=0),
        off[inside].max(axis=0),
        np.median(off[inside], axis=0),
        int(border.sum()),
        off[border].max(axis=0) if border.any() else np.full(len(lower), np.nan),
    )
