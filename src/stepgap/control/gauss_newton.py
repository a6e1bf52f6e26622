"""Bounded least squares: damped Gauss–Newton steps from a start, for one problem and for many at once.

The point sought lies within a box; a vector-valued function is zero or of least norm there. Each step minimises
the norm of the linearised function within the box (`box_step`, `box_steps`), with Levenberg's damping. Broyden's
rank-one updates keep the Jacobian, because a new one costs several evaluations.

Far from zero the squared norm has a curvature that the linearised function lacks. `minimise` estimates it as the weight
of the damping with which the model would have predicted the last trial, a scalar form of the secant estimates of
Dennis, Gay and Welsch (An adaptive nonlinear least-squares algorithm, 1981). Near a zero that weight vanishes.

`minimise` solves one problem and evaluates the Jacobian again where the updated one is poor. `minimise_many` takes
the steps of many problems together, so that each round is one large batch of evaluations, and never evaluates the
Jacobian again; problems that do not converge are left to `minimise`. It is a separate function because it works on
arrays of problems: one search for both, whose evaluations are collected in batches, took four times as long for a
command table, 191 instead of 45 µs for each of 13⁴ nodes. It estimates no curvature, so its damping grows and shrinks
by factors, as a multiple of the squared norm of the Jacobian.

A function value that is not finite (a step that fails) is worse than any other.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import get_lapack_funcs

from stepgap.step import Array

TOLERANCE = 1e-9
"""Norm at which a solution is not improved further."""
REACHED = 1e-6
"""Norm that counts as zero; an integrated map is not more accurate than this."""
CLOSE_ENOUGH = REACHED / 10
"""Norm at which one of many solutions is not improved further."""
FLAT = 1e-10
"""A point is stationary when the squared norm can fall by no more than this fraction, unless another one is given."""
NEARBY = 1e-3
"""A Jacobian with Broyden's updates counts as exact up to this distance from the point of its evaluation."""
MOST_TRIALS = 25
MOST_ROUNDS = 20
MOST_DAMPING = 1e4
"""A search ends with a larger damping, relative to the squared norm of the Jacobian."""
LEAST_DAMPING = 1e-2
"""Damping after a trial without a value, relative to the squared norm of the Jacobian; it grows eightfold with each."""
NO_DAMPING = 1e-6
"""A smaller damping is neglected, relative to the squared norm of the Jacobian."""
ACCEPTED = 1e-4
"""A step is taken if the squared norm falls by this fraction of what was expected."""
(_gesv,) = get_lapack_funcs(("gesv",), dtype=np.float64)

Function = Callable[[Array], Array]
"""Points (…, k) to values (…, n), NaN where there is none."""
Jacobian = Callable[[Array], Array]
"""A point (k,) to the Jacobian of the function (n, k)."""
ManyFunctions = Callable[[NDArray[np.intp], Array], Array]
"""Numbers of problems (p,) and a point (p, k) for each to their values (p, n), NaN where there is none."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of a search.

    Attributes:
        point: Shape (k,).
        distance: Norm of the function there; infinite where it has no value.
        converged: Whether the point is a zero or a local minimum; points without a value or strong curvature may
            prevent this.
    """

    point: Array
    distance: float
    converged: bool


def minimise(function: Function, jacobian: Jacobian, start: Array, improvement: float = FLAT) -> Solution:
    """Searches a local minimum of the norm within |point| ≤ 1; the result is never worse than the start.

    Args:
        function: Of a point.
        jacobian: Of the function.
        start: Shape (k,).
        improvement: The search ends where the squared norm can fall by no more than this fraction.
    """
    point = np.clip(start, -1.0, 1.0)
    value, matrix, origin, damping = function(point), jacobian(point), point, 0.0
    if not (np.isfinite(value).all() and np.isfinite(matrix).all()):
        return Solution(point, float(norms(value)), converged=False)
    # `value` is the function at `point`, the best point so far. `matrix` is the Jacobian at `origin` with Broyden's
    # updates since then: that no step helps is believed only near `origin`; elsewhere the Jacobian is renewed.
    for _ in range(MOST_TRIALS):
        cost, size = _square(value), float(np.sum(matrix**2))
        if cost <= TOLERANCE**2 or damping > MOST_DAMPING * size:
            break
        damping = damping if damping > NO_DAMPING * size else 0.0
        step = box_step(matrix, value, -1.0 - point, 1.0 - point, damping)
        change = matrix @ step
        linear = _square(value + change)
        expected = cost - linear - damping * _square(step)
        if expected <= improvement * cost:
            if _is_near(point, origin):
                return Solution(point, float(norms(value)), converged=True)
            matrix, origin = _renewed(jacobian, point, matrix), point
            continue
        trial = function(point + step)
        if not np.isfinite(trial).all():
            damping = max(8 * damping, LEAST_DAMPING * size)
            continue
        if cost - _square(trial) <= ACCEPTED * expected and cost > REACHED**2:
            fraction = _least_on_parabola(cost, 2 * float(value @ change), _square(trial))
            shorter = function(point + fraction * step)
            if _square(shorter) < cost:
                step, change, trial = fraction * step, fraction * change, shorter
                linear = _square(value + change)
                expected = cost - linear
        # A trial that is not taken teaches as much as one that is: the damping with which |linear|² + damping |step|²
        # would have given the norm found there, and a matrix that agrees with it in the direction of the step.
        gain = cost - _square(trial)
        damping = max(0.0, (_square(trial) - linear) / _square(step))
        matrix = matrix + (trial - value - change)[:, None] * (step / _square(step))
        stays_near = _is_near(point, origin)
        if gain > ACCEPTED * expected:
            point, value = point + step, trial
        elif cost <= REACHED**2:
            break
        if gain < 0.25 * expected and not stays_near:
            matrix, origin = _renewed(jacobian, point, matrix), point
    distance = float(norms(value))
    return Solution(point, distance, converged=distance <= REACHED)


def minimise_many(
    functions: ManyFunctions, points: Array, values: Array, matrices: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Searches a local minimum of the norm within |point| ≤ 1 for each problem, from one start each.

    Args:
        functions: The functions.
        points: Starts; shape (P, k).
        values: Values of the functions there; shape (P, n).
        matrices: Their Jacobians there; shape (P, n, k).

    Returns:
        Points (P, k), values (P, n), and which problems converged (P,).
    """
    points, values, matrices = points.copy(), values.copy(), matrices.copy()
    converged, relative_damping = np.zeros(len(points), bool), np.zeros(len(points))
    active = np.flatnonzero(np.isfinite(matrices).all(axis=(1, 2)))
    # `active` has the numbers of the problems that still run; each local array has one row for each of them. `points`
    # and `values` change only where the norm falls, so whenever a problem leaves, it keeps the best that it has found.
    for _ in range(MOST_ROUNDS):
        point, value, matrix = points[active], values[active], matrices[active]
        cost = np.sum(value**2, axis=1)
        damping = relative_damping[active] * np.sum(matrix**2, axis=(1, 2))
        step = box_steps(matrix, value, -1 - point, 1 - point, damping)
        linear = value + np.einsum("pnm,pm->pn", matrix, step)
        expected = cost - np.sum(linear**2, axis=1)
        done = (cost <= CLOSE_ENOUGH**2) | (expected <= FLAT * cost)
        converged[active[done]] = True
        remaining = ~done & (relative_damping[active] <= MOST_DAMPING)
        active, step, linear = active[remaining], step[remaining], linear[remaining]
        cost, expected = cost[remaining], expected[remaining]
        if not active.size:
            break
        trial = functions(active, points[active] + step)
        failed = ~np.isfinite(trial).all(axis=1)
        gain = np.where(failed, -np.inf, cost - np.sum(trial**2, axis=1))
        update = (trial - linear)[:, :, None] * step[:, None, :] / np.sum(step**2, axis=1)[:, None, None]
        matrices[active[~failed]] += update[~failed]
        better = gain > ACCEPTED * expected
        points[active[better]] += step[better]
        values[active[better]] = trial[better]
        more = np.maximum(8 * relative_damping[active], LEAST_DAMPING)
        relative_damping[active] = np.where(better, relative_damping[active] / 8, more)
    return points, values, converged


def box_step(matrix: Array, value: Array, lower: Array, upper: Array, damping: float) -> Array:
    """Minimises |matrix p + value|² + damping |p|² over lower ≤ p ≤ upper by active sets; returns p (k,).

    Args:
        matrix: Shape (n, k).
        value: Shape (n,).
        lower: Not above 0; shape (k,).
        upper: Not below 0; shape (k,).
        damping: Not negative.
    """
    k = len(lower)
    if damping or matrix.shape == (k, k):
        normal = (matrix.T @ matrix + damping * np.eye(k), -matrix.T @ value) if damping else (matrix, -value)
        _, _, step, failure = _gesv(*normal)
        if not failure and ((lower <= step) & (step <= upper)).all():
            return step
    matrix = np.vstack([matrix, np.sqrt(damping) * np.eye(k)])
    value = np.append(value, np.zeros(k))
    step, free = np.zeros(k), np.ones(k, bool)
    # `step` stays in the box, and each coordinate that is not `free` rests on a bound. A turn ends at the first bound
    # that the move meets, or at the minimum among the free ones; there the coordinate is freed whose bound costs most.
    for _ in range(4 * k + 4):
        move = np.zeros(k)
        move[free] = np.linalg.lstsq(matrix[:, free], -(matrix @ step + value), rcond=None)[0]
        to_bound = np.full(k, np.inf)
        moving = np.abs(move) > 1e-100
        to_bound[moving] = (np.where(move > 0, upper, lower) - step)[moving] / move[moving]
        first = int(np.argmin(to_bound))
        if to_bound[first] < 1:
            step = step + to_bound[first] * move
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


def box_steps(matrices: Array, values: Array, lower: Array, upper: Array, damping: Array) -> Array:
    """Minimises |matrix p + value|² + damping |p|² over lower ≤ p ≤ upper for each problem, as `box_step`; p (P, m).

    Args:
        matrices: Shape (P, n, m).
        values: Shape (P, n).
        lower: Not above 0; shape (P, m).
        upper: Not below 0; shape (P, m).
        damping: Not negative; shape (P,).
    """
    m = matrices.shape[2]
    hessian = np.einsum("pni,pnj->pij", matrices, matrices)
    gradient = np.einsum("pni,pn->pi", matrices, values)
    size = np.trace(hessian, axis1=1, axis2=2)
    hessian = hessian + (damping + 1e-14 * size + 1e-300)[:, None, None] * np.eye(m)
    steps, side, active = np.zeros_like(lower), np.zeros(lower.shape, int), np.arange(len(values))
    # Each turn of this primal-dual active-set method (Hintermüller, Ito, Kunisch, 2003) solves for the free coordinates
    # (`side` 0), then fixes those beyond a bound, and frees those whose bound holds them back from the minimum. Usually
    # two or three turns suffice; the few problems that go round in circles are solved by `box_step`.
    for _ in range(2 * m + 4):
        now, bounds = side[active], np.where(side[active] < 0, lower[active], upper[active])
        free = now == 0
        rest = np.where(free, 0.0, bounds)
        system = hessian[active] * (free[:, :, None] & free[:, None, :]) + (~free)[:, :, None] * np.eye(m)
        right = np.where(free, -gradient[active] - np.einsum("pij,pj->pi", hessian[active], rest), bounds)
        step = np.linalg.solve(system, right[..., None])[..., 0]
        slope = gradient[active] + np.einsum("pij,pj->pi", hessian[active], step)
        beyond = np.where(step < lower[active], -1, np.where(step > upper[active], 1, 0))
        held = np.where(now * slope <= 0, now, 0)
        following = np.where(free, beyond, held)
        steps[active], side[active] = step, following
        active = active[(following != now).any(axis=1)]
        if not active.size:
            break
    for row in active:
        steps[row] = box_step(matrices[row], values[row], lower[row], upper[row], float(damping[row]))
    return np.clip(steps, lower, upper)


def _square(value: Array) -> float:
    """Squared norm; not finite where the function has no value."""
    return float(value @ value)


def _least_on_parabola(cost: float, slope: float, trial: float) -> float:
    """Where the parabola with a value and slope at 0 and another value at 1 is least, within 0.1 … 0.5.

    A step that is too long because of curvature is shortened to this fraction (Nocedal and Wright, Numerical
    Optimization, Sec. 3.5).
    """
    return float(np.clip(-slope / (2 * (trial - cost - slope)), 0.1, 0.5))


def _is_near(point: Array, origin: Array) -> bool:
    return bool(np.abs(point - origin).max() <= NEARBY)


def _renewed(jacobian: Jacobian, point: Array, matrix: Array) -> Array:
    """Evaluates the Jacobian at a point; returns the old one where it is not finite."""
    fresh = jacobian(point)
    return fresh if np.isfinite(fresh).all() else matrix


def norms(values: Array) -> Array:
    """Norms of function values, infinite where there is none; (…, n) to (…)."""
    length = np.linalg.norm(values, axis=-1)
    return np.where(np.isfinite(length), length, np.inf)
