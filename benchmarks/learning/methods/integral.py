"""Integral correction: a constant added to the nominal map, b ← b + k (actual − nominal − b) after every step.

The method `integral` of a run (`stepgap.experiment.methods`) is this integral, too, but for its weak prior. As a
residual of a `Learner` it has what the default learner has: the disturbance filter, and the removal of the periodic
part from earlier deployments.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self, final

import numpy as np

from benchmarks.learning.methods.physical_parameters import AdjustedMap
from benchmarks.learning.methods.redeployment import corrected
from benchmarks.learning.trial import Trial
from stepgap.experiment.methods import INTEGRAL_GAIN, METHODS
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.observations import error_of
from stepgap.learning.residual import Residual, no_residual
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.step import Array, StepMap


def integral(trial: Trial) -> Sequence[Steps]:
    """The method `integral` of a run: an integrator as the residual of a learner."""
    return corrected(trial, METHODS["integral"].learning)


def integral_plain(trial: Trial) -> Sequence[Steps]:
    """A redeployment with the integral alone."""
    return [trial.first, trial.measure(IntegralCorrection.start(trial.nominal, trial.first, INTEGRAL_GAIN), 1)]


@final
@dataclass(frozen=True, eq=False)
class IntegralCorrection:
    """The integral correction alone, in place of a `Learner`; a failed step does not change b.

    Attributes:
        nominal: Map of the physics model.
        gain: k.
        shift: b; shape (n,).
    """

    nominal: StepMap
    gain: float
    shift: Array

    @classmethod
    def start(cls, nominal: StepMap, log: Steps, gain: float) -> Self:
        """The correction before a deployment, with b after the steps of a log."""
        correction = cls(nominal, gain, np.zeros(len(nominal.space.state)))
        for logged in log.completed():
            correction = correction.after(logged)
        return correction

    @property
    def conditioned_residual(self) -> Residual:
        """Empty residual: there is no model of the error except b."""
        return no_residual(len(self.nominal.space.state), len(self.nominal.space.command))

    @property
    def failures(self) -> Array:
        """Empty array, since failed steps are not stored; shape (0, n + m)."""
        return np.empty((0, sum(self.conditioned_residual.sizes)))

    @property
    def pending(self) -> None:
        """None: there is nothing to compute in the background."""

    def step_map(self) -> CorrectedMap:
        """Map for planning the next step; it has no standard deviation."""
        return CorrectedMap(AdjustedMap(self.nominal, self.shift), self.conditioned_residual)

    def found(self, context: Mapping[str, float]) -> Self:  # noqa: ARG002
        """The same: it has no context inputs."""
        return self

    def after(self, logged: LoggedStep) -> Self:
        """The correction after the executed step."""
        error = error_of(logged.record, self.nominal)
        if not np.isfinite(error).all():
            return self
        return replace(self, shift=self.shift + self.gain * (error - self.shift))
