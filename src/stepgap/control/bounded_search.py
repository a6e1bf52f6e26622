"""Bounded least squares without a good start: Gauss–Newton steps first, then from better starts, which are sampled."""

import numpy as np

from stepgap.control.box_points import box_points
from stepgap.control.gauss_newton import REACHED, Function, Jacobian, Solution, minimise, norms
from stepgap.step import Array

SEARCHED = (81, 1089)
"""Numbers of points of the coarse and of the fine sample, of two commands 9² and 33².

The fine one is used if the function has no value at any point of the coarse one.
"""
BASINS = 3  # Largest number of sampled points from which Gauss–Newton steps start
SEPARATION = 0.5  # Starts differ by more than this in at least one coordinate
ZOOMED = 25  # Number of points around the best one in each round of `_zoom`, of two commands 5²
ZOOM_ROUNDS = 13
"""Number of rounds of `_zoom`; in the last one the points are within 0.5 · 2⁻¹² = 1.2e-4 of the best one."""


def bounded_solution(function: Function, jacobian: Jacobian, start: Array) -> Solution:
    """Searches the zero, or else the least norm, of a function within |point| ≤ 1; it may miss the global minimum.

    Args:
        function: Of a point.
        jacobian: Of the function.
        start: Where the search begins, such as the command of the step before; shape (k,).
    """
    # From the given start, or from the middle where the function has no value there:
    best = minimise(function, jacobian, start)
    if np.isinf(best.distance):
        best = minimise(function, jacobian, np.zeros_like(start))
    if best.distance <= REACHED:
        return best
    # From sampled points. One near the best solution that is no better than it would lead to it again.
    points, distance = _sample(function, len(start))
    for row in _separate_starts(points, distance):
        near_best = np.abs(points[row] - best.point).max() <= SEPARATION
        if near_best and distance[row] >= best.distance:
            continue
        solution = minimise(function, jacobian, points[row])
        best = solution if solution.distance < best.distance else best
        if best.distance <= REACHED:
            return best
    # Without derivatives, where they have not led to a minimum:
    return best if best.converged or np.isinf(best.distance) else _zoom(function, best)


def _sample(function: Function, k: int) -> tuple[Array, Array]:
    """Points (N, k) and their distances (N,); the fine ones if the coarse ones have no value."""
    coarse, fine = SEARCHED
    points = box_points(coarse, k)
    distance = norms(function(points))
    if not np.isfinite(distance).any():
        points = box_points(fine, k)
        distance = norms(function(points))
    return points, distance


def _separate_starts(points: Array, distance: Array) -> list[int]:
    """Rows of at most `BASINS` closest points (N, k) that lie apart from each other, the closest first.

    Distances (N,) are infinite where the function has no value.
    """
    remaining = distance.copy()
    rows = list[int]()
    for _ in range(BASINS):
        closest = int(np.argmin(remaining))
        if not np.isfinite(remaining[closest]):
            break
        rows.append(closest)
        remaining[np.abs(points - points[closest]).max(axis=-1) <= SEPARATION] = np.inf
    return rows


def _zoom(function: Function, best: Solution) -> Solution:
    """Samples nearer and nearer around the best point that is no minimum, such as one at the border of the domain."""
    point = best.point
    distance = best.distance
    offsets = box_points(ZOOMED, len(point))
    width = SEPARATION
    for _ in range(ZOOM_ROUNDS):
        points = np.clip(point + width * offsets, -1.0, 1.0)
        distances = norms(function(points))
        if distances.min() < distance:
            point = points[np.argmin(distances)]
            distance = float(distances.min())
        width = width / 2
    return Solution(point, distance, converged=False)
