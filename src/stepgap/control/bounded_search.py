"""Bounded least squares without a good start: Gauss–Newton steps first, then a grid that looks for better starts."""

import numpy as np
from scipy.ndimage import minimum_filter

from stepgap.control.gauss_newton import REACHED, Function, Jacobian, Solution, minimise, norms
from stepgap.step import Array, box_grid

GRID_POINTS = (81, 1089)
"""Points of the search grid; the second is tried where the function has no value at any of the first."""
BASINS = 3
"""Number of starts that are tried."""
ZOOM_ROUNDS = 12


def solve(function: Function, jacobian: Jacobian, start: Array, bound: float) -> Solution:
    """The zero, or else the least norm, of a function within |point| ≤ bound, as far as a search can tell.

    The grid of the search lies within |point| ≤ 1 whatever the bound.
    """
    best = minimise(function, jacobian, start, bound)
    if best.distance <= REACHED:
        return best
    points, distance = _sample(function, len(start))
    spacing = 2 / (len(distance) - 1)
    for index in _basins(distance)[:BASINS]:
        known = np.abs(points[index] - best.point).max() <= spacing and distance[index] >= best.distance
        if not known:
            best = min(best, minimise(function, jacobian, points[index], bound), key=lambda solution: solution.distance)
        if best.distance <= REACHED:
            return best
    return best if best.settled or np.isinf(best.distance) else _zoom(function, best, spacing, bound)


def _sample(function: Function, k: int) -> tuple[Array, Array]:
    """Grid over |point| ≤ 1 (s, …, s, k) and its distances (s, …, s); the finer one if the first has no value."""
    coarse, fine = (box_grid(max(3, round(total ** (1 / k))), k) for total in GRID_POINTS)
    distance = norms(function(coarse))
    return (coarse, distance) if np.isfinite(distance).any() else (fine, norms(function(fine)))


def _basins(distance: Array) -> list[tuple[int, ...]]:
    """Grid points with no closer neighbour, the closest first."""
    lowest = (distance == minimum_filter(distance, size=3, mode="nearest")) & np.isfinite(distance)
    return sorted((tuple(index) for index in np.argwhere(lowest)), key=lambda index: distance[index])


def _zoom(function: Function, best: Solution, width: float, bound: float) -> Solution:
    """Finer and finer grids around a point that is not settled, such as one where values end."""
    point, distance = best.point, best.distance
    offsets = box_grid(5, len(point)).reshape(-1, len(point))
    for _ in range(ZOOM_ROUNDS):
        points = np.clip(point + width * offsets, -bound, bound)
        distances = norms(function(points))
        if distances.min() < distance:
            point, distance = points[np.argmin(distances)], float(distances.min())
        width = width / 2
    return Solution(point, distance, settled=False)
