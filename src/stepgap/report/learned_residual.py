"""The residual that the report of a run describes, and the steps from which it was learned."""

from dataclasses import dataclass
from functools import cached_property

from stepgap.base.errors import InputError
from stepgap.experiment.run import Run
from stepgap.learning.regression import Prediction
from stepgap.learning.residual import Residual
from stepgap.learning.steps import Steps
from stepgap.step import Array


@dataclass(frozen=True, eq=False)
class LearnedResidual:
    """A residual, which was fitted to the steps of earlier deployments, and the deployment that begins with it.

    Attributes:
        iteration: Number of the deployment; after a single one that was online that of the next
            one, which was not executed.
        residual: Residual at the start of the deployment.
    """

    iteration: int
    residual: Residual

    @property
    def steps(self) -> int:
        """Number of steps to which the residual was fitted; 0 for a residual that does not keep them."""
        return len(self.residual.regressions[0].values)

    @cached_property
    def leave_one_out(self) -> list[Prediction]:
        """Predictions by each regression of each of its N values from all others."""
        singles = [slice(row, row + 1) for row in range(self.steps)]
        return [regression.left_out(singles) for regression in self.residual.regressions]

    @property
    def standardised_errors(self) -> list[Array]:
        """Differences of the values from their leave-one-out predictions, in standard deviations; shapes (N,)."""
        pairs = zip(self.residual.regressions, self.leave_one_out, strict=True)
        return [(regression.values - predicted.mean) / predicted.std for regression, predicted in pairs]


def steps_before(run: Run, iteration: int) -> Steps:
    """All steps that were known before a deployment; without those of an earlier run if these are lost."""
    try:
        earlier = run.known
    except InputError:
        earlier = Steps(run.recorded.space)
    return Steps(run.recorded.space) + earlier + run.recorded.before(iteration)
