"""What a run learnt: the last residual of its folder, and what it says of the steps it was fitted to."""

from dataclasses import dataclass
from pathlib import Path

from stepgap.learning.gaussian_process import leave_one_out
from stepgap.learning.gaussian_process_regression import GaussianProcessRegression
from stepgap.learning.residual import Hindsight, Residual
from stepgap.learning.sparse_gaussian_process import Process
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
    def processes(self) -> list[Process]:
        """The Gaussian process of each state coordinate; empty of a residual of another kind."""
        regressions = self.residual.regressions
        return [each.process for each in regressions if isinstance(each, GaussianProcessRegression)]


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


def input_quantities(space: StepSpace, hindsight: Hindsight) -> list[Quantity]:
    """Names and units of a residual's inputs; those of the past are measured in half ranges."""
    before = [Quantity(f"error of {each.name} before", "half ranges", -1, 1) for each in space.state]
    if hindsight.features == "previous_step":
        past = (*space.command, *space.state)
        before += [Quantity(f"{each.name} before", "half ranges", -1, 1) for each in past]
    elif hindsight.features == "none":
        before = []
    time = [Quantity("time", "memories", -1, 1)] if hindsight.timed else []
    return [*space.state, *space.command, *before, *time]


def surprise(process: Process) -> Array:
    """How many standard deviations each value lies from what all others predict of it; shape (N,)."""
    mean, std = leave_one_out(process)
    return (process.values - mean) / std
