"""The step controller's answers for many states and targets at once (Eqs. 11, 13).

The same search as `step_controller`, but every node takes its step together with all others, so that a map sees few
large batches in place of many single points. A coarse sample of the command bounds, shared by all targets of a state,
gives each node its starts; Gauss–Newton steps with Broyden's updates do the rest, and what they cannot settle goes to
`StepController`. Points are scaled as there: the command bounds are -1 and 1, residuals count half ranges.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import minimum_filter

from stepgap.control.step_controller import BASINS, FLAT, MOST_DAMPING, REACHED, StepController
from stepgap.step import Array, Codes, StepFailed, StepMap, StepSpace, StepStatus, box_grid

CLOSE_ENOUGH = REACHED / 10
"""Distance [half ranges] at which a node is not improved further."""
SAMPLES = 27
"""About how many commands the sample has that is shared by all targets of a state."""
MOST_ROUNDS = 20

Nodes = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Answers:
    """What the step controller would say of S states with T targets each.

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
    """The P = S T nodes of a call, those of one state side by side."""

    step_map: StepMap
    space: StepSpace
    states: Array
    targets: Array

    def residuals(self, nodes: Nodes, points: Array) -> Array:
        """Scaled residuals (k, n) of nodes (k,) at scaled points (k, m), NaN where the step fails."""
        next_state, status = self.step_map.evaluate(self.states[nodes], self.space.command_at(points))
        value = (next_state - self.targets[nodes]) / self.space.state_scale
        return np.where((status == StepStatus.OK)[:, None], value, np.nan)


def solve_many(step_map: StepMap, states: ArrayLike, targets: ArrayLike) -> Answers:
    """Commands whose next states are the targets, or come closest to them, within the command bounds.

    Args:
        step_map: The map.
        states: Shape (S, n).
        targets: Shape (S, T, n), or (T, n) if all states have the same.

    Raises:
        ValueError: A size does not fit the map, or a number is not finite.
    """
    space = step_map.space
    n, m = len(space.state), len(space.command)
    states, targets = np.asarray(states, float), np.asarray(targets, float)
    if states.ndim != 2 or targets.ndim not in (2, 3) or states.shape[1] != n or targets.shape[-1] != n:
        raise ValueError(f"states {states.shape} and targets {targets.shape}; they must be (S, {n}) and (S, T, {n})")
    if not (np.isfinite(states).all() and np.isfinite(targets).all()):
        raise ValueError("states and targets must be finite numbers")
    targets = np.broadcast_to(targets, (len(states), *targets.shape[-2:]))
    count = targets.shape[1]
    problem = _Problem(step_map, space, np.repeat(states, count, axis=0), targets.reshape(-1, n))
    points, values, settled = _solve(problem, states, count)
    commands, predicted = space.command_at(points), problem.targets + values * space.state_scale
    reached = _length(values) <= REACHED
    status = np.full(len(points), int(StepStatus.OK))
    free = (np.abs(points) < 1).sum(axis=1)
    doubtful = (m > n) | (free >= min(2, m))  # Broyden's updates know the slope along one free direction, not along all
    suspect = ~reached & (~settled | doubtful)
    _ask_controller(problem, np.flatnonzero(suspect), count, commands, predicted, reached, status)
    shape = (len(states), count)
    return Answers(
        commands.reshape(*shape, m), predicted.reshape(*shape, n), reached.reshape(shape), status.reshape(shape)
    )


def _solve(problem: _Problem, states: Array, count: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Points (P, m), their residuals (P, n), and which of them settled; from one basin of the sample after another."""
    space, n, m = problem.space, len(problem.space.state), len(problem.space.command)
    grid = box_grid(max(3, round(SAMPLES ** (1 / m))), m)
    sample = grid.reshape(-1, m)
    next_states, status = problem.step_map.evaluate(states[:, None], space.command_at(sample))
    next_states = np.where((status == StepStatus.OK)[..., None], next_states, np.nan)[:, None]
    targets = problem.targets.reshape(len(states), count, 1, n)
    sampled = ((next_states - targets) / space.state_scale).reshape(-1, len(sample), n)
    ranks = _basins(_length(sampled).reshape(-1, *grid.shape[:-1]), m)
    best, at = sampled[np.arange(len(ranks)), ranks[:, 0]], sample[ranks[:, 0]]
    settled = np.zeros(len(ranks), bool)
    for choice in ranks.T:
        nodes = np.flatnonzero((choice >= 0) & (_length(best) > REACHED))
        matrices = _slopes(problem, states, nodes // count, sample, choice[nodes])
        points, values = sample[choice[nodes]], sampled[nodes, choice[nodes]]
        ended = _descend(problem, nodes, points, values, matrices)
        closer = _length(values) <= _length(best[nodes])
        chosen = nodes[closer]
        at[chosen], best[chosen], settled[chosen] = points[closer], values[closer], ended[closer]
    return at, best, settled


def _basins(length: Array, m: int) -> Nodes:
    """Samples with no closer neighbour, the closest first, -1 where there are no more; (P, s, …, s) to (P, BASINS)."""
    lowest = (length == minimum_filter(length, size=(1,) + (3,) * m, mode="nearest")) & np.isfinite(length)
    length = np.where(lowest, length, np.inf).reshape(len(length), -1)
    order = np.argsort(length, axis=1, kind="stable")[:, :BASINS]
    return np.where(np.isfinite(np.take_along_axis(length, order, axis=1)), order, -1)


def _slopes(problem: _Problem, states: Array, rows: Nodes, sample: Array, choice: Nodes) -> Array:
    """Scaled Jacobians (k, n, m) at chosen samples of states; each pair is asked for once."""
    space, n = problem.space, len(problem.space.state)
    distinct, where = np.unique(rows * len(sample) + choice, return_inverse=True)
    commands = space.command_at(sample[distinct % len(sample)])
    jacobian = problem.step_map.jacobian(states[distinct // len(sample)], commands)[..., n:]
    return (jacobian * space.command_scale / space.state_scale[:, None])[where]


def _descend(problem: _Problem, nodes: Nodes, points: Array, values: Array, matrices: Array) -> NDArray[np.bool_]:
    """Damped Gauss–Newton steps of all nodes; changes the arrays in place and says which nodes settled."""
    settled, damping = np.zeros(len(points), bool), np.zeros(len(points))
    active = np.flatnonzero(np.isfinite(matrices).all(axis=(1, 2)))
    for _ in range(MOST_ROUNDS):
        point, value, matrix = points[active], values[active], matrices[active]
        cost = np.sum(value**2, axis=1)
        step = box_steps(matrix, value, -1 - point, 1 - point, damping[active])
        linear = value + np.einsum("pnm,pm->pn", matrix, step)
        expected = cost - np.sum(linear**2, axis=1)
        done = (cost <= CLOSE_ENOUGH**2) | (expected <= FLAT * cost)
        settled[active[done]] = True
        left = ~done & (damping[active] <= MOST_DAMPING)
        active, step, linear = active[left], step[left], linear[left]
        cost, expected = cost[left], expected[left]
        if not active.size:
            break
        trial = problem.residuals(nodes[active], points[active] + step)
        failed = ~np.isfinite(trial).all(axis=1)
        gain = np.where(failed, -np.inf, cost - np.sum(trial**2, axis=1))
        update = (trial - linear)[:, :, None] * step[:, None, :] / np.sum(step**2, axis=1)[:, None, None]
        matrices[active[~failed]] += update[~failed]
        better = gain > 1e-4 * expected
        points[active[better]] += step[better]
        values[active[better]] = trial[better]
        damping[active] = np.where(better, damping[active] / 8, np.maximum(8 * damping[active], 1e-2))
    return settled


def box_steps(matrices: Array, values: Array, lower: Array, upper: Array, damping: Array) -> Array:
    """For every node the p of least |matrix p + value|² + damping |matrix|² |p|² in lower ≤ p ≤ upper; shape (P, m).

    The least value lies within one of the box's 3ᵐ faces, its inside among them; each is tried.

    Args:
        matrices: Shape (P, n, m).
        values: Shape (P, n).
        lower: Not above 0; shape (P, m).
        upper: Not below 0; shape (P, m).
        damping: Not negative; shape (P,).
    """
    m = matrices.shape[2]
    hessian = np.einsum("pni,pnj->pij", matrices, matrices)
    slope = np.einsum("pni,pn->pi", matrices, values)
    size = np.trace(hessian, axis1=1, axis2=2)
    hessian = hessian + ((damping + 1e-14) * size + 1e-300)[:, None, None] * np.eye(m)
    best, least = np.zeros_like(lower), np.full(len(values), np.inf)
    for face in product((0, -1, 1), repeat=m):
        chosen = np.array(face)
        step, inside = _on_face(chosen, hessian, slope, lower, upper)
        cost = np.einsum("pi,pi->p", slope + np.einsum("pij,pj->pi", hessian, step) / 2, step)
        better = inside & (cost < least)
        best[better], least[better] = step[better], cost[better]
    return best


def _on_face(
    chosen: NDArray[np.int64], hessian: Array, slope: Array, lower: Array, upper: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """The steps that solve the problem with some coordinates at a bound, and whether they lie in the box."""
    free, fixed = np.flatnonzero(chosen == 0), np.flatnonzero(chosen)
    step = np.where(chosen < 0, lower, np.where(chosen > 0, upper, 0.0))
    if free.size:
        pull = slope[:, free] + np.einsum("pij,pj->pi", hessian[:, free][:, :, fixed], step[:, fixed])
        step[:, free] = np.linalg.solve(hessian[:, free][:, :, free], -pull[..., None])[..., 0]
    return step, np.all((step >= lower) & (step <= upper), axis=1)


def _length(values: Array) -> Array:
    """Norms of residuals, infinite where the step fails; (…, n) to (…)."""
    length = np.linalg.norm(values, axis=-1)
    return np.where(np.isfinite(length), length, np.inf)


def _ask_controller(
    problem: _Problem,
    nodes: Nodes,
    count: int,
    commands: Array,
    predicted: Array,
    reached: NDArray[np.bool_],
    status: Codes,
) -> None:
    """Solves nodes one by one and writes the answers; a state without any step is searched once."""
    controller, fallen = StepController(problem.step_map), dict[int, StepStatus]()
    for node in nodes:
        row = int(node) // count
        if row not in fallen:
            try:
                plan = controller(problem.states[node], problem.targets[node], commands[node])
                commands[node], predicted[node], reached[node] = plan.command, plan.predicted, plan.reached
                continue
            except StepFailed as failure:
                fallen[row] = failure.status
        commands[node], predicted[node], status[node] = np.nan, np.nan, fallen[row]
