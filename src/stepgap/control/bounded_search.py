"""Bounded least squares without a good start: Gauss–Newton steps first, then a search for better starts."""

import numpy as np

from stepgap.control.box_points import box_points
from stepgap.control.gauss_newton import REACHED, Function, Jacobian, Solution, minimise, norms
from stepgap.step import Array

SEARCHED = (81, 1089)
"""Numbers of points of the coarse and the fine search; the fine one is used if no coarse point has a value."""
BASINS = 3  # Number of these points from which a search starts
SEPARATION = 0.5  # Starts differ by more than this in at least one coordinate
ZOOMED = 25  # Number of points around the best one in each round of a search that comes nearer and nearer
ZOOM_ROUNDS = 13


def bounded_solution(function: Function, jacobian: Jacobian, start: Array) -> Solution:
    """Searches the zero, or else the least norm, of a function within |point| ≤ 1; it may miss the global minimum."""
    best = minimise(function, jacobian, start)
    if np.isinf(best.distance):  # the command of the step before may fail here; what is left of a budget goes on
        best = minimise(function, jacobian, np.zeros_like(start))
    if best.distance <= REACHED:
        return best
    points, distance = _sample(function, len(start))
    for row in _separate_starts(points, distance):
        near_best = np.abs(points[row] - best.point).max() <= SEPARATION
        if not (near_best and distance[row] >= best.distance):
            other = minimise(function, jacobian, points[row])
            best = other if other.distance < best.distance else best
        if best.distance <= REACHED:
            return best
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
    left = distance.copy()
    rows = list[int]()
    for _ in range(BASINS):
        closest = int(np.argmin(left))
        if not np.isfinite(left[closest]):
            break
        rows.append(closest)
        left[np.abs(points - points[closest]).max(axis=-1) <= SEPARATION] = np.inf
    return rows


def _zoom(function: Function, best: Solution) -> Solution:
    """Searches nearer and nearer around a point without convergence, such as one at the border of the domain."""
    point = best.point
    distance = best.distance
    width = SEPARATION
    offsets = box_points(ZOOMED, len(point))
    for _ in range(ZOOM_ROUNDS):
        points = np.clip(point + width * offsets, -1.0, 1.0)
        distances = norms(function(points))
        if distances.min() < distance:
            point = points[np.argmin(distances)]
            distance = float(distances.min())
        width = width / 2
    return Solution(point, distance, converged=False)
