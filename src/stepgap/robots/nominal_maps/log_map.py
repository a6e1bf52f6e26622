"""A nominal map fitted to recorded steps, for a robot without equations of motion and without a simulator."""

from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepgap.base.errors import StepGapError
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.observations import observe
from stepgap.learning.residual import join_points
from stepgap.learning.residual_fit import fit_residual
from stepgap.learning.steps import Steps
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import Array, Outcome, StepMap, StepSpace

RELATIVE_ROUNDING = 1e-9
"""Variation that counts as rounding, as a fraction of the largest absolute value of a coordinate."""

ABSOLUTE_ROUNDING = 1e-12  # Variation that counts as rounding in any case [unit of the coordinate]

DEPENDENT = 1e-12
"""Coordinates, each in standard deviations, vary only together if their variance in some direction is less than this
fraction of the largest one."""

NAMED_COMPONENT = 0.01
"""Least component of a coordinate in such a direction, a unit vector, with which it is named."""


@final
@dataclass(frozen=True, eq=False, repr=False)
class LogMap(StepMap):
    """A linear regression of the next state in state and command; made by `fit_log_map`. No step fails on it.

    It is a nominal map, so it has no standard deviation, and may be corrected.

    Attributes:
        fitted: A constant map, corrected by the regression.
        gaps: Sentences on effects that the steps do not show.
    """

    fitted: CorrectedMap
    gaps: tuple[str, ...] = ()

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self.fitted.space

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states, and status codes OK, or INVALID where a number is not finite."""
        return self.fitted.evaluate(state, command)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n, n + m). NaN where a number is not finite."""
        return self.fitted.jacobian(state, command)


def fit_log_map(log: Steps) -> LogMap:
    """Fits a nominal map to recorded steps.

    Where commands were chosen by a controller, they and the states vary together, and their effects are known only
    together. So vary the commands at random while the log is recorded.

    The derivative by a coordinate that did not vary is zero.

    Args:
        log: Steps of the robot, at least two more than there are coordinates of state and command.

    Raises:
        StepGapError: There are too few steps.
    """
    space = log.space
    n = len(space.state)
    m = len(space.command)
    flat = AffineMap(space, space.state_centre, space.command_centre, space.state_centre, np.zeros((n, n + m)))
    observed = observe(log, flat)
    if len(observed) < n + m + 2:
        raise StepGapError(f"{len(observed)} completed steps, but a map needs at least {n + m + 2}")
    points = join_points(observed.state, observed.command)
    # what does not vary by more than rounding
    fixed = np.ptp(points, axis=0) <= np.maximum(RELATIVE_ROUNDING * np.abs(points).max(axis=0), ABSOLUTE_ROUNDING)
    centre = join_points(space.state_centre, space.command_centre)
    points = np.where(fixed, centre, points)  # where the scaled coordinate is zero, so is its weight
    varied = replace(observed, state=points[:, :n], command=points[:, n:])
    return LogMap(CorrectedMap(flat, fit_residual("linear", varied)), _gaps(space, points, fixed))


def _gaps(space: StepSpace, points: Array, fixed: NDArray[np.bool_]) -> tuple[str, ...]:
    """Sentences on the coordinates of points (N, n + m) that are fixed, and on those that vary only together."""
    names = np.array(space.names)
    gaps = [f"{name} did not vary in the log, so its effect is unknown: the map has none" for name in names[fixed]]
    if not fixed.all():
        variances, directions = np.linalg.eigh(np.atleast_2d(np.corrcoef(points[:, ~fixed].T)))
        unseen = directions[:, variances < DEPENDENT * variances[-1]]
        together = names[~fixed][(np.abs(unseen) > NAMED_COMPONENT).any(axis=1)]
        if together.size:
            effect = "only their common effect is known; vary each alone"
            gaps.append(f"{', '.join(together)} vary only together in the log, so {effect}")
    return tuple(gaps)
