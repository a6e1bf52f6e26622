"""Bounded least squares without a good start: Gauss–Newton steps first, then a search for better starts on a grid."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from stepgap.control.gauss_newton import REACHED, Function, Jacobian, Solution, minimise, norms
from stepgap.step import Array, box_grid

GRID_POINTS = (81, 1089)
"""Numbers of points of the coarse and the fine search grid; the fine one is used if no coarse point has a value."""
BASINS = 3
"""Number of grid points from which a search starts."""
ZOOM_ROUNDS = 12


def solve(function: Function, jacobian: Jacobian, start: Array) -> Solution:
    """Searches the zero, or else the least norm, of a function within |point| ≤ 1; it may miss the global minimum."""
    best = minimise(function, jacobian, start)
    if best.distance <= REACHED:
        return best
    points, distance = _sample(function, len(start))
    spacing = 2 / (len(distance) - 1)
    for index in _basins(distance)[:BASINS]:
        known = np.abs(points[index] - best.point).max() <= spacing and distance[index] >= best.distance
        if not known:
            best = min(best, minimise(function, jacobian, points[index]), key=lambda solution: solution.distance)
        if best.distance <= REACHED:
            return best
    return best if best.converged or np.isinf(best.distance) else _zoom(function, best, spacing)


def _sample(function: Function, k: int) -> tuple[Array, Array]:
    """Grid over |point| ≤ 1 (s, …, s, k) and its distances (s, …, s); the fine one if the coarse one has no value."""
    coarse, fine = (box_grid(max(3, round(total ** (1 / k))), k) for total in GRID_POINTS)
    distance = norms(function(coarse))
    return (coarse, distance) if np.isfinite(distance).any() else (fine, norms(function(fine)))


def _basins(distance: Array) -> list[tuple[int, ...]]:
    """Grid points with no closer neighbour, the closest first."""
    lowest = np.argwhere(local_minima(distance, distance.ndim))
    return sorted((tuple(index) for index in lowest), key=lambda index: distance[index])


def local_minima(values: Array, k: int) -> NDArray[np.bool_]:
    """Which finite values on a grid of k axes have no smaller neighbour; (…, s, …, s) to the same shape.

    `scipy.ndimage` has this filter, too, but its import takes ten times as long as the choice of a command, in which it
    would be made.
    """
    grid = tuple(range(values.ndim - k, values.ndim))
    padded = np.pad(values, [(0, 0)] * (values.ndim - k) + [(1, 1)] * k, mode="edge")
    neighbours = sliding_window_view(padded, (3,) * k, axis=grid)
    return (values == neighbours.min(axis=tuple(range(values.ndim, values.ndim + k)))) & np.isfinite(values)


def _zoom(function: Function, best: Solution, width: float) -> Solution:
    """Searches on finer and finer grids around a point without convergence, such as one at the border of the domain."""
    point, distance = best.point, best.distance
    offsets = box_grid(5, len(point)).reshape(-1, len(point))
    for _ in range(ZOOM_ROUNDS):
        points = np.clip(point + width * offsets, -1.0, 1.0)
        distances = norms(function(points))
        if distances.min() < distance:
            point, distance = points[np.argmin(distances)], float(distances.min())
        width = width / 2
    return Solution(point, distance, converged=False)
