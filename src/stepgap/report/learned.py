"""The learned residual of a run, and its leave-one-out predictions of the steps to which it was fitted."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from stepgap.learning.regression import Prediction
from stepgap.learning.residual import HistoryInputs, Residual
from stepgap.records.missing import Missing
from stepgap.records.model_files import model_path, read_model
from stepgap.records.run_folder import RunRecord
from stepgap.step import Array, Quantity, StepSpace


@dataclass(frozen=True, eq=False)
class LearnedResidual:
    """A residual, which was fitted to the steps of earlier deployments, and the deployment that begins with it.

    Attributes:
        iteration: Number of the deployment; after an online run that of the next one, which was not executed.
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


def described_residual(record: RunRecord, final: Residual | Missing) -> LearnedResidual | Missing:
    """The residual with which the last deployment began, or the reason why it is not known.

    If that is deployment 0, and it learned from the nominal map on, it is the residual fitted afterwards to all steps.

    Args:
        record: The run.
        final: The residual fitted to all steps, or the reason why it is not known.

    Raises:
        ValueError: The file is not a model of this run.
        OSError: It cannot be read.
    """
    if not record.has_unsaved_residual:
        return read_learned_residual(record.folder, record.shown_iterations[-1], record.space)
    if isinstance(final, Missing):
        return Missing(f"deployment 0 learned while it ran, so no model was saved before it, and {final.reason}")
    return LearnedResidual(1, final)


def read_learned_residual(folder: Path, last: int, space: StepSpace) -> LearnedResidual | Missing:
    """Reads the residual with which a deployment began, or the reason why none was saved.

    Args:
        folder: The run folder.
        last: Number of the deployment.
        space: State and command of the run.

    Raises:
        ValueError: The file is not a model of this run.
        OSError: It cannot be read.
    """
    residual = read_model(folder, last, space)
    if residual is not None:
        return LearnedResidual(last, residual)
    name = model_path(folder, last).relative_to(folder)
    return Missing(f"there is no {name}" if last else "deployment 0 used the nominal map")


def input_quantities(space: StepSpace, history_inputs: HistoryInputs) -> list[Quantity]:
    """Names and units of a residual's inputs; those of the previous step are normalised by half their range."""
    previous = [Quantity(f"previous error of {each.name}", "half ranges", -1, 1) for each in space.state]
    if history_inputs.lagged_inputs == "previous_step":
        previous += [Quantity(f"previous {each.name}", "half ranges", -1, 1) for each in (*space.command, *space.state)]
    elif history_inputs.lagged_inputs == "none":
        previous = []
    time = [Quantity("time", "forgetting times", -1, 1)] if history_inputs.timed else []
    return [*space.state, *space.command, *previous, *time]
