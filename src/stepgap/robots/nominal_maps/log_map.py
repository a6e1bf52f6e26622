"""A nominal map fitted to recorded steps, for a robot without equations of motion and without a simulator."""

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.errors import StepGapError
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.observations import observe
from stepgap.learning.residual_fit import fit_residual
from stepgap.learning.step_log import StepLog
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import Array, Outcome, StepMap, StepSpace


@final
@dataclass(frozen=True, eq=False)
class LogMap(StepMap):
    """A linear regression of the next state in state and command; made by `fit_log_map`. No step fails on it.

    It is a nominal map, so it has no standard deviation, and may be corrected.

    Attributes:
        fitted: A constant map, corrected by the regression.
    """

    fitted: CorrectedMap

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


def fit_log_map(log: StepLog) -> LogMap:
    """Fits a nominal map to recorded steps.

    Where commands were chosen by a controller, they and the states vary together, and their effects are known only
    together. So vary the commands at random while the log is recorded.

    Args:
        log: Steps of the robot, at least two more than there are coordinates of state and command.

    Raises:
        StepGapError: There are too few steps.
    """
    space = log.space
    n, m = len(space.state), len(space.command)
    if len(log.completed()) < n + m + 2:
        raise StepGapError(f"{len(log.completed())} completed steps, but a map needs at least {n + m + 2}")
    flat = AffineMap(space, space.state_centre, space.command_centre, space.state_centre, np.zeros((n, n + m)))
    return LogMap(CorrectedMap(flat, fit_residual("linear", observe(log, flat))))
