"""What a run learnt: the last residual of its folder, and what it says of the steps it was fitted to."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from stepgap.learning.regression import Prediction
from stepgap.learning.residual import HistoryInputs, Residual
from stepgap.records.model_files import read_model
from stepgap.step import Array, Quantity, StepSpace


@dataclass(frozen=True, eq=False)
class Learnt:
    """A residual and the deployment that used it; it was fitted to the steps of those before.

    Attributes:
        iteration: Number of that deployment.
        residual: What it was corrected by when it began.
    """

    iteration: int
    residual: Residual

    @property
    def steps(self) -> int:
        """Number of steps that the residual was fitted to; 0 of one that keeps none."""
        return len(self.residual.regressions[0].values)

    @cached_property
    def leave_one_out(self) -> list[Prediction]:
        """What each regression predicts of each of its N values from all others."""
        singles = [slice(row, row + 1) for row in range(self.steps)]
        return [regression.left_out(singles) for regression in self.residual.regressions]

    @property
    def standardised_errors(self) -> list[Array]:
        """Distance of each value from its leave-one-out prediction, in standard deviations; shapes (N,)."""
        pairs = zip(self.residual.regressions, self.leave_one_out, strict=True)
        return [(regression.values - predicted.mean) / predicted.std for regression, predicted in pairs]


def read_learnt(folder: Path, last: int, space: StepSpace) -> Learnt | None:
    """The residual with which a deployment began; None if no model was saved, as before one with the nominal map.

    Args:
        folder: The run folder.
        last: Number of the deployment.
        space: State and command of the run.

    Raises:
        ValueError: The file is not a model of this run.
        OSError: It cannot be read.
    """
    residual = read_model(folder, last, space)
    return None if residual is None else Learnt(last, residual)


def input_quantities(space: StepSpace, history_inputs: HistoryInputs) -> list[Quantity]:
    """Names and units of a residual's inputs; those of the step before are normalised by half their range."""
    before = [Quantity(f"error of {each.name} before", "half ranges", -1, 1) for each in space.state]
    if history_inputs.lagged_inputs == "previous_step":
        before += [Quantity(f"{each.name} before", "half ranges", -1, 1) for each in (*space.command, *space.state)]
    elif history_inputs.lagged_inputs == "none":
        before = []
    time = [Quantity("time", "memories", -1, 1)] if history_inputs.timed else []
    return [*space.state, *space.command, *before, *time]
