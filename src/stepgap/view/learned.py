"""A residual as a function of one of its inputs, with the others held constant."""

from dataclasses import dataclass

import numpy as np

from stepgap.base.normal import INTERVAL_95
from stepgap.learning.residual import Residual
from stepgap.step import Array, StepSpace

POINTS = 60
"""Number of inputs of a curve."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Error of the nominal map, actual − nominal, along one input.

    Attributes:
        inputs: Increasing values of the input, including that of the present step; shape (k,).
        mean: Mean error; shape (k, n) [units of the state].
        margin: Half-width of the band in which 95 % of the errors are expected; shape (k, n).
        here: Index of the present step's input.
    """

    inputs: Array
    mean: Array
    margin: Array
    here: int


def curve_along(residual: Residual, space: StepSpace, point: Array, index: int) -> Curve:
    """The residual as a function of one coordinate of a point.

    Args:
        residual: Residual, conditioned on the history of the step if it has history inputs.
        space: Ranges of the coordinates; the curve covers the range and the point.
        point: State and requested command of the present step; shape (n + m,).
        index: Index of the varied coordinate.
    """
    quantity, present = (*space.state, *space.command)[index], point[index]
    ends = min(quantity.lower, present), max(quantity.upper, present)
    inputs = np.union1d(np.linspace(*ends, POINTS), [present])
    points = np.tile(point, (len(inputs), 1))
    points[:, index] = inputs
    margin = INTERVAL_95 * residual.std(points, include_noise=True)
    return Curve(inputs, residual.mean(points), margin, int(np.searchsorted(inputs, present)))
