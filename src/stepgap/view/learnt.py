"""A residual along one of its inputs, the others held constant."""

from dataclasses import dataclass

import numpy as np

from stepgap.base.normal import INTERVAL_95
from stepgap.learning.residual import Residual
from stepgap.step import Array, StepSpace

POINTS = 60
"""Inputs of a curve."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Error of the nominal map, actual − nominal, along one input.

    Attributes:
        inputs: Rising; one of them is the present step's; shape (k,).
        mean: Expected; shape (k, n) [units of the state].
        margin: Half the band in which 95 % of steps are expected to err; shape (k, n).
        here: Which of the inputs is the present step's.
    """

    inputs: Array
    mean: Array
    margin: Array
    here: int


def curve_along(residual: Residual, space: StepSpace, point: Array, index: int) -> Curve:
    """The residual along one coordinate of a point.

    Args:
        residual: Conditioned on the history of the step, where it has history inputs.
        space: Ranges of the coordinates; the curve covers that, and the point.
        point: State and applied command of the present step; shape (n + m,).
        index: Which coordinate is varied.
    """
    quantity, present = (*space.state, *space.command)[index], point[index]
    ends = min(quantity.lower, present), max(quantity.upper, present)
    inputs = np.union1d(np.linspace(*ends, POINTS), [present])
    points = np.tile(point, (len(inputs), 1))
    points[:, index] = inputs
    margin = INTERVAL_95 * residual.std(points, include_noise=True)
    return Curve(inputs, residual.mean(points), margin, int(np.searchsorted(inputs, present)))
