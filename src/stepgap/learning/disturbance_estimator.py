"""The disturbance during a deployment, as it is estimated step by step from the errors of a residual's predictions."""

from dataclasses import dataclass, replace
from typing import Self, final

import numpy as np

from stepgap.learning.disturbance import DisturbanceFilter
from stepgap.learning.outliers import is_improbable
from stepgap.learning.residual import Residual
from stepgap.step import Array


@final
@dataclass(frozen=True, eq=False)
class DisturbanceEstimator:
    """Estimate of the disturbance between two steps of a deployment, to which outliers do not contribute; immutable.

    Attributes:
        state_scale: Half the range of use of each state coordinate; shape (n,).
        drift: Whether the disturbance is estimated where there is a correction; otherwise it is zero.
        reject_outliers: Whether single steps with improbable errors are outliers.
        filter: The estimate.
        improbable: Whether the error of the latest step was improbable.
        outlier: Whether the latest step was an outlier: improbable, after a step that was not.
    """

    state_scale: Array
    drift: bool
    reject_outliers: bool
    filter: DisturbanceFilter
    improbable: bool = False
    outlier: bool = False

    @classmethod
    def start(cls, state_scale: Array, *, drift: bool, reject_outliers: bool) -> Self:
        """Returns the estimate before the first step; its arguments are those of `DisturbanceEstimator`."""
        return cls(state_scale, drift, reject_outliers, DisturbanceFilter.initial(len(state_scale)))

    def predict(self, residual: Residual, phase: float) -> tuple[Array, Array]:
        """Offset of the next state, and its standard deviation; shapes (n,) and (n,) [units of the state].

        Args:
            residual: The residual to which the offset is added.
            phase: Phase at which the step starts [rad], NaN if it is unknown.
        """
        return self.filter.offset(phase), self.filter.std(phase) * residual.noise_std

    def after(self, residual: Residual, error: Array, std: Array, phase: float) -> Self:
        """Returns the estimate after a step.

        Args:
            residual: The residual that predicted the step.
            error: Error of its prediction without the offset; shape (n,) [units of the state].
            std: Standard deviation of that prediction, with noise; shape (n,) [units of the state].
            phase: Phase at which the step started [rad], NaN if it is unknown.
        """
        offset, offset_std = self.predict(residual, phase)
        innovation, known = (error - offset) / self.state_scale, len(residual.regressions[0].points)
        total_std = np.hypot(std, offset_std) / self.state_scale
        improbable = self.reject_outliers and is_improbable(innovation, total_std, known)
        outlier = improbable and not self.improbable
        learned = self.drift and residual.kind != "none" and not outlier
        found = self.filter.updated(error, phase) if learned else self.filter
        return replace(self, filter=found, improbable=improbable, outlier=outlier)
