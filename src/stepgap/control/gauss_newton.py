"""Bounded least squares: damped Gauss–Newton steps from a start.

The point sought lies within a box; a vector-valued function is zero or of least norm there. Each step minimises
the norm of the linearised function within the box (`box_step`), with Levenberg's damping. Broyden's rank-one updates
keep the Jacobian, because a new one costs several evaluations; it is evaluated again where the updated one is poor.

Far from zero the squared norm has a curvature that the linearised function lacks. It is estimated as the weight of the
damping with which the model would have predicted the last trial, a scalar form of the secant estimates of Dennis, Gay
and Welsch (An adaptive nonlinear least-squares algorithm, 1981). Near a zero that weight vanishes.

A function value that is not finite (a step that fails) is worse than any other.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import get_lapack_funcs

from stepgap.step import Array

TOLERANCE = 1e-9  # Norm at which a solution is not improved further
REACHED = 1e-6  # Norm that counts as zero; an integrated map is not more accurate than this
FLAT = 1e-10
"""A point is stationary when the squared norm can fall by no more than this fraction, unless another one is given."""
NEARBY = 1e-3
"""A Jacobian with Broyden's updates counts as exact up to this distance from the point of its evaluation."""
MOST_TRIALS = 25
MOST_DAMPING = 1e4  # A search ends with a larger damping, relative to the squared norm of the Jacobian
LEAST_DAMPING = 1e-2
"""Damping after a trial without a value, relative to the squared norm of the Jacobian; it grows eightfold with each."""
NO_DAMPING = 1e-6  # A smaller damping is neglected, relative to the squared norm of the Jacobian
ACCEPTED = 1e-4  # A step is taken if the squared norm falls by this fraction of what was expected
(_gesv,) = get_lapack_funcs(("gesv",), dtype=np.float64)

Function = Callable[[Array], Array]
"""Points (…, k) to values (…, n), NaN where there is none."""
Jacobian = Callable[[Array], Array]
"""A point (k,) to the Jacobian of the function (n, k)."""


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
    value = function(point)
    if not np.isfinite(value).all():
        return Solution(point, np.inf, converged=False)
    matrix = jacobian(point)
    origin = point
    damping = 0.0
    if not np.isfinite(matrix).all():
        return Solution(point, float(norms(value)), converged=False)
    # `value` is the function at `point`, the best point so far. `matrix` is the Jacobian at `origin` with Broyden's
    # updates since then: that no step helps is believed only near `origin`; elsewhere the Jacobian is renewed.
    for _ in range(MOST_TRIALS):
        cost = _square(value)
        size = float(np.sum(matrix**2))
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
            matrix = _renewed(jacobian, point, matrix)
            origin = point
            continue
        trial = function(point + step)
        if not np.isfinite(trial).all():
            damping = max(8 * damping, LEAST_DAMPING * size)
            continue
        if cost - _square(trial) <= ACCEPTED * expected and cost > REACHED**2:
            fraction = _least_on_parabola(cost, 2 * float(value @ change), _square(trial))
            shorter = function(point + fraction * step)
            if _square(shorter) < cost:
                step = fraction * step
                change = fraction * change
                trial = shorter
                linear = _square(value + change)
                expected = cost - linear
        # A trial that is not taken teaches as much as one that is: the damping with which |linear|² + damping |step|²
        # would have given the norm found there, and a matrix that agrees with it in the direction of the step.
        gain = cost - _square(trial)
        damping = max(0.0, (_square(trial) - linear) / _square(step))
        matrix = matrix + (trial - value - change)[:, None] * (step / _square(step))
        stays_near = _is_near(point, origin)
        if gain > ACCEPTED * expected:
            point = point + step
            value = trial
        elif cost <= REACHED**2:
            break
        if gain < 0.25 * expected and not stays_near:
            matrix = _renewed(jacobian, point, matrix)
            origin = point
    distance = float(norms(value))
    return Solution(point, distance, converged=distance <= REACHED)


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
    step = np.zeros(k)
    free = np.ones(k, bool)
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
