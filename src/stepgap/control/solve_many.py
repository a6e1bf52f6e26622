"""Commands of the step controller for many states and targets at once (Eqs. 11, 13).

A node is a state with one of its targets. All nodes take their Gauss–Newton steps together, so that a map evaluates few
large batches instead of many single points. A coarse sample of the command bounds, shared by all targets of a state,
gives each node its starts; nodes that do not converge from them are solved by `StepController`. Points and errors are
scaled as there; the error is zero in coordinates without a target.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepgap.control.bounded_search import separate_starts
from stepgap.control.box_points import box_points
from stepgap.control.gauss_newton import REACHED, minimise_many, norms
from stepgap.control.step_controller import StepController
from stepgap.step import Array, Codes, StepFailed, StepMap, StepSpace, StepStatus

SAMPLES = 27
"""Approximate number of sampled commands, which are shared by all targets of a state."""

Nodes = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Answers:
    """Commands of the step controller for S states with T targets each.

    Attributes:
        command: Within the bounds; NaN where no command makes a step. Shape (S, T, m).
        predicted: Next state of that command; shape (S, T, n).
        reached: Whether `predicted` is the target; shape (S, T).
        status: Why no command makes a step, else OK; shape (S, T).
    """

    command: Array
    predicted: Array
    reached: NDArray[np.bool_]
    status: Codes


@dataclass(frozen=True, eq=False)
class _Problem:
    """The P = S T nodes of a call; those of one state are adjacent."""

    step_map: StepMap
    space: StepSpace
    states: Array
    targets: Array

    wanted: NDArray[np.bool_]

    def errors(self, nodes: Nodes, chosen: Nodes, points: Array) -> Array:
        """Scaled errors (k, n) of `nodes[chosen]` (k,) at scaled points (k, m), NaN where the step fails."""
        nodes = nodes[chosen]
        next_state, status = self.step_map.evaluate(self.states[nodes], self.space.command_at(points))
        value = np.where(self.wanted[nodes], (next_state - self.targets[nodes]) / self.space.error_scale, 0.0)
        return np.where((status == StepStatus.OK)[:, None], value, np.nan)


def solve_many(step_map: StepMap, states: ArrayLike, targets: ArrayLike) -> Answers:
    """Finds the commands whose next states are the targets, or come closest to them, within the command bounds.

    Args:
        step_map: The map.
        states: Shape (S, n).
        targets: Shape (S, T, n), or (T, n) if all states have the same targets; NaN in coordinates without one.

    Raises:
        ValueError: A size does not fit the map, a state is not finite, or a target is infinite.
    """
    space = step_map.space
    n, m = len(space.state), len(space.command)
    states, targets = np.asarray(states, float), np.asarray(targets, float)
    if states.ndim != 2 or targets.ndim not in (2, 3) or states.shape[1] != n or targets.shape[-1] != n:
        raise ValueError(f"states {states.shape} and targets {targets.shape}; they must be (S, {n}) and (S, T, {n})")
    if not np.isfinite(states).all() or np.isinf(targets).any():
        raise ValueError("states and targets must be finite numbers, or a target NaN where there is none")
    targets = np.broadcast_to(targets, (len(states), *targets.shape[-2:]))
    count = targets.shape[1]
    wanted = space.has_target(targets).reshape(-1, n)
    problem = _Problem(step_map, space, np.repeat(states, count, axis=0), targets.reshape(-1, n), wanted)
    points, values, converged = _solve(problem, states, count)
    commands = space.command_at(points)
    if wanted.all():
        predicted = problem.targets + values * space.error_scale
    else:
        predicted = step_map.evaluate(problem.states, commands).next_state
    reached = norms(values) <= REACHED
    status = np.full(len(points), int(StepStatus.OK))
    free = (np.abs(points) < 1).sum(axis=1)
    # Broyden's updates give the derivative along one free direction, not along all.
    doubtful = (m > wanted.sum(axis=1)) | (free >= min(2, m))
    unsolved = np.flatnonzero(~reached & (~converged | doubtful))
    found = _solve_one_by_one(problem, unsolved, count, commands[unsolved])
    commands[unsolved], predicted[unsolved], reached[unsolved], status[unsolved] = found
    shape = (len(states), count)
    return Answers(
        commands.reshape(*shape, m), predicted.reshape(*shape, n), reached.reshape(shape), status.reshape(shape)
    )


def _solve(problem: _Problem, states: Array, count: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Points (P, m), their errors (P, n), and which of them converged; from one start after another."""
    space, n, m = problem.space, len(problem.space.state), len(problem.space.command)
    sample = box_points(SAMPLES, m)
    next_states, status = problem.step_map.evaluate(states[:, None], space.command_at(sample))
    next_states = np.where((status == StepStatus.OK)[..., None], next_states, np.nan)[:, None]
    targets = problem.targets.reshape(len(states), count, 1, n)
    errors = np.where(
        problem.wanted.reshape(targets.shape), (next_states - targets) / space.error_scale, 0 * next_states
    )
    sampled = errors.reshape(-1, len(sample), n)
    ranks = separate_starts(sample, norms(sampled))
    best, at = sampled[np.arange(len(ranks)), ranks[:, 0]], sample[ranks[:, 0]]
    converged = np.zeros(len(ranks), bool)
    # Each turn starts from the next closest start of the nodes that are not yet solved, in one batch. `best` is the
    # least error so far. An equal one replaces it: a search that did not move tells, too, whether it converged.
    for choice in ranks.T:
        nodes = np.flatnonzero((choice >= 0) & (norms(best) > REACHED))
        matrices = _jacobians(problem, states, nodes // count, sample, choice[nodes])
        matrices = np.where(problem.wanted[nodes, :, None], matrices, 0.0 * matrices)
        starts = sample[choice[nodes]], sampled[nodes, choice[nodes]], matrices
        points, values, ended = minimise_many(partial(problem.errors, nodes), *starts)
        closer = norms(values) <= norms(best[nodes])
        chosen = nodes[closer]
        at[chosen], best[chosen], converged[chosen] = points[closer], values[closer], ended[closer]
    return at, best, converged


def _jacobians(problem: _Problem, states: Array, rows: Nodes, sample: Array, choice: Nodes) -> Array:
    """Scaled Jacobians (k, n, m) at chosen samples of states; each pair is evaluated once."""
    space, n = problem.space, len(problem.space.state)
    distinct, where = np.unique(rows * len(sample) + choice, return_inverse=True)
    commands = space.command_at(sample[distinct % len(sample)])
    jacobian = problem.step_map.jacobian(states[distinct // len(sample)], commands)[..., n:]
    return space.scaled_jacobian(jacobian)[where]


def _solve_one_by_one(
    problem: _Problem, nodes: Nodes, count: int, starts: Array
) -> tuple[Array, Array, NDArray[np.bool_], Codes]:
    """Solves nodes one by one, and searches a state without any step once.

    Args:
        problem: All nodes.
        nodes: Numbers of those that are solved; shape (k,).
        count: Number of targets of each state.
        starts: Commands at which the searches begin; shape (k, m).

    Returns:
        As in `Answers`: commands (k, m), predicted next states (k, n), reached (k,) and status (k,).
    """
    controller, failed = StepController(problem.step_map), dict[int, StepStatus]()
    commands, predicted = np.full_like(starts, np.nan), np.full((len(nodes), len(problem.space.state)), np.nan)
    reached, status = np.zeros(len(nodes), bool), np.full(len(nodes), int(StepStatus.OK))
    for i, (node, start) in enumerate(zip(nodes.tolist(), starts, strict=True)):
        row = node // count
        if row not in failed:
            try:
                plan = controller(problem.states[node], problem.targets[node], start)
                commands[i], predicted[i], reached[i] = plan.command, plan.predicted, plan.reached
                continue
            except StepFailed as failure:
                failed[row] = failure.status
        status[i] = failed[row]
    return commands, predicted, reached, status
