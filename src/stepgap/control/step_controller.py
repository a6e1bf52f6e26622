"""What to command so that the next apex is the target (Sec. 4.3, Eqs. 11 and 13).

`StepController` asks any `StepMap`, nominal or corrected. A few Gauss–Newton steps within the command bounds answer
nearly every time; where they do not reach the target, a grid over the bounds looks for a better place to start.
All points here are scaled: the command bounds are -1 and 1, and residuals count half ranges of the state.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import get_lapack_funcs
from scipy.ndimage import minimum_filter

from stepgap.step import Array, StepFailed, StepMap, StepStatus, box_grid

TOLERANCE = 1e-9
"""Distance [half ranges] at which a solution is not improved further."""
REACHED = 1e-6
"""Distance [half ranges] that counts as reached; an integrated map is not smoother than this."""
FLAT = 1e-10
"""A point is stationary when the squared distance can fall by no more than this fraction."""
NEARBY = 1e-3
"""A Jacobian serves, with Broyden's updates, as exact this far around the point where it was taken."""
MOST_TRIALS = 40
MOST_DAMPING = 1e4
GRID_POINTS = (81, 1089)
"""Points of the search grid; the second is tried where every step of the first fails."""
BASINS = 3
ZOOM_ROUNDS = 12
(_gesv,) = get_lapack_funcs(("gesv",), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class StepPlan:
    """A command and what the map predicts of it.

    Attributes:
        command: Within the bounds; shape (m,).
        predicted: Next state; shape (n,).
        reached: Whether `predicted` is the target.
        distance: From `predicted` to the target: Euclidean, each coordinate divided by half its range of use.
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

        def residual(point: Array) -> Array:
            next_state = self.step_map.evaluate(state, command_at(point)).next_state
            if point.ndim == 1:
                known[point.tobytes()] = next_state
            return (next_state - target) / state_scale

        def slope(point: Array) -> Array:
            jacobian = self.step_map.jacobian(state, command_at(point))[:, n:]
            return jacobian * space.command_scale / state_scale[:, None]

        solution = solve(residual, slope, space.point_of(start), bound=1.0)
        command = command_at(solution.point)
        predicted = known.get(solution.point.tobytes())
        if predicted is None or not np.isfinite(predicted).all():
            predicted = self.step_map(state, command)
        distance = float(np.linalg.norm((predicted - target) / state_scale))
        return StepPlan(command, predicted, distance <= REACHED, distance)


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a search ended.

    Attributes:
        point: Scaled unknowns; shape (k,).
        distance: Norm of the residual there; infinite where the step fails.
        settled: Whether it is a zero or no direction leads closer; if not, failing steps or a strong bend stood in
            the way.
    """

    point: Array
    distance: float
    settled: bool


Residual = Callable[[Array], Array]
"""Scaled points (…, k) to scaled residuals (…, n), NaN where the step fails."""
Slope = Callable[[Array], Array]
"""Scaled point (k,) to the Jacobian of the residual (n, k)."""


def solve(residual: Residual, slope: Slope, start: Array, bound: float) -> Solution:
    """The zero, or else the least norm, of a residual within |point| ≤ bound, as far as a search can tell.

    The grid of the search lies within |point| ≤ 1 whatever the bound.
    """
    best = descend(residual, slope, start, bound)
    if best.distance <= REACHED:
        return best
    points, distance = _sample(residual, len(start))
    spacing = 2 / (len(distance) - 1)
    for index in _basins(distance)[:BASINS]:
        known = np.abs(points[index] - best.point).max() <= spacing and distance[index] >= best.distance
        if not known:
            best = min(best, descend(residual, slope, points[index], bound), key=lambda solution: solution.distance)
        if best.distance <= REACHED:
            return best
    return best if best.settled or np.isinf(best.distance) else _zoom(residual, best, spacing, bound)


def descend(residual: Residual, slope: Slope, start: Array, bound: float) -> Solution:
    """Damped Gauss–Newton steps within |point| ≤ bound, from a start to the nearest least distance.

    The Jacobian is kept by Broyden's rank-one updates and taken anew only where it misleads. A failing step counts
    as worse than any other, so the answer is never worse than the start.
    """
    point = np.clip(start, -bound, bound)
    value, matrix, origin, damping = residual(point), slope(point), point, 0.0
    if not (np.isfinite(value).all() and np.isfinite(matrix).all()):
        return Solution(point, float(_length(value)), settled=False)
    for _ in range(MOST_TRIALS):
        cost = value @ value
        if cost <= TOLERANCE**2 or damping > MOST_DAMPING:
            break
        weight = damping * np.sum(matrix**2) if damping else 0.0
        step = box_step(matrix, value, -bound - point, bound - point, weight)
        linear = value + matrix @ step
        expected = cost - linear @ linear
        if expected <= FLAT * cost:
            if _is_near(point, origin):
                return Solution(point, float(_length(value)), settled=True)
            matrix, origin, damping = _renewed(slope, point, matrix), point, 0.0
            continue
        trial = residual(point + step)
        failed = not np.isfinite(trial).all()
        gain = -np.inf if failed else cost - trial @ trial
        if not failed:
            matrix = matrix + (trial - linear)[:, None] * (step / (step @ step))
        before = point
        if gain > 1e-4 * expected:
            point, value = point + step, trial
        elif cost <= REACHED**2:
            break
        if gain > 0.75 * expected:
            damping = damping / 8 if damping > 1e-2 else 0.0
        elif gain < 0.25 * expected:
            if failed or _is_near(before, origin):
                damping = max(8 * damping, 1e-2)
            else:
                matrix, origin = _renewed(slope, point, matrix), point
    distance = float(_length(value))
    return Solution(point, distance, settled=distance <= REACHED)


def box_step(matrix: Array, value: Array, lower: Array, upper: Array, damping: float) -> Array:
    """The p of least |matrix p + value|² + damping |p|² in lower ≤ p ≤ upper, by active sets; shape (k,).

    Args:
        matrix: Shape (n, k).
        value: Shape (n,).
        lower: Not above 0; shape (k,).
        upper: Not below 0; shape (k,).
        damping: Not negative.
    """
    k = len(lower)
    if damping == 0.0 and matrix.shape == (k, k):
        _, _, step, failure = _gesv(matrix, -value)
        if not failure and ((lower <= step) & (step <= upper)).all():
            return step
    matrix = np.vstack([matrix, np.sqrt(damping) * np.eye(k)])
    value = np.append(value, np.zeros(k))
    step, free = np.zeros(k), np.ones(k, bool)
    for _ in range(4 * k + 4):
        move = np.zeros(k)
        move[free] = np.linalg.lstsq(matrix[:, free], -(matrix @ step + value), rcond=None)[0]
        room = np.full(k, np.inf)
        moving = np.abs(move) > 1e-100
        room[moving] = (np.where(move > 0, upper, lower) - step)[moving] / move[moving]
        first = int(np.argmin(room))
        if room[first] < 1:
            step = step + room[first] * move
            step[first], free[first] = (upper if move[first] > 0 else lower)[first], False
            continue
        step = step + move
        gradient = matrix.T @ (matrix @ step + value)
        outward = np.where(free, 0.0, np.where(step >= upper, gradient, -gradient))
        worst = int(np.argmax(outward))
        if outward[worst] <= 1e-14 * np.linalg.norm(matrix) * np.linalg.norm(value):
            break
        free[worst] = True
    return np.clip(step, lower, upper)


def _is_near(point: Array, origin: Array) -> bool:
    return bool(np.abs(point - origin).max() <= NEARBY)


def _renewed(slope: Slope, point: Array, matrix: Array) -> Array:
    """The Jacobian at a point, or the old one where a failing step nearby leaves none."""
    fresh = slope(point)
    return fresh if np.isfinite(fresh).all() else matrix


def _sample(residual: Residual, k: int) -> tuple[Array, Array]:
    """Grid over |point| ≤ 1 (s, …, s, k) and its distances (s, …, s), the finer one if all steps of the first fail."""
    coarse, fine = (box_grid(max(3, round(total ** (1 / k))), k) for total in GRID_POINTS)
    distance = _length(residual(coarse))
    return (coarse, distance) if np.isfinite(distance).any() else (fine, _length(residual(fine)))


def _length(residuals: Array) -> Array:
    """Norms of residuals, infinite where the step fails; (…, n) to (…)."""
    length = np.linalg.norm(residuals, axis=-1)
    return np.where(np.isfinite(length), length, np.inf)


def _basins(distance: Array) -> list[tuple[int, ...]]:
    """Grid points with no closer neighbour, the closest first."""
    lowest = (distance == minimum_filter(distance, size=3, mode="nearest")) & np.isfinite(distance)
    return sorted((tuple(index) for index in np.argwhere(lowest)), key=lambda index: distance[index])


def _zoom(residual: Residual, best: Solution, width: float, bound: float) -> Solution:
    """Ever finer grids around a point that is not settled: along a border of failing steps no slope leads."""
    point, distance = best.point, best.distance
    offsets = box_grid(5, len(point)).reshape(-1, len(point))
    for _ in range(ZOOM_ROUNDS):
        points = np.clip(point + width * offsets, -bound, bound)
        distances = _length(residual(points))
        if distances.min() < distance:
            point, distance = points[np.argmin(distances)], float(distances.min())
        width = width / 2
    return Solution(point, distance, settled=False)


def as_vector(name: str, values: ArrayLike, size: int) -> Array:
    """The values as an array of shape (size,); ValueError if they are not."""
    vector = np.asarray(values, float)
    if vector.shape != (size,):
        raise ValueError(f"{name} has shape {vector.shape}; it must be ({size},)")
    return vector
