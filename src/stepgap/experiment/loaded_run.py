"""A recorded run: what was learned, and the controller of any of its deployments."""

from dataclasses import dataclass
from pathlib import Path
from typing import final

from stepgap.base.errors import InputError, message_of
from stepgap.experiment.deployment import DeploymentController
from stepgap.experiment.inputs import load_known
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import Experiment, read_experiment
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.learner import Learner
from stepgap.learning.steps import Steps, as_past
from stepgap.records.model_files import read_model
from stepgap.records.steps_csv import read_step_log
from stepgap.step import StepMap


@final
@dataclass(frozen=True, eq=False)
class LoadedRun:
    """A run that was recorded, finished or not; `load_run` reads it.

    Attributes:
        folder: The run folder.
        settings: Settings of the experiment.
        nominal: Nominal map.
        steps: All recorded steps.
        known: Steps that were known before the first deployment, numbered as deployments before number 0.
    """

    folder: Path
    settings: Experiment
    nominal: StepMap
    steps: Steps
    known: Steps

    def learner(self, iteration: int | None = None) -> Learner:
        """State of learning at the start of a deployment.

        The residual is read from the run's folder. After the last deployment there is none; then it is fitted to all
        steps, as a further deployment would do, which takes seconds.

        Args:
            iteration: Number of the deployment; None for the one after the last.

        Raises:
            InputError: There is no such deployment, or the model in the folder is not that of this run and its nominal
                map.
        """
        after = max(self.steps.iterations, default=-1) + 1
        number = after if iteration is None else iteration
        if not 0 <= number <= after:
            raise InputError(f"{self.folder}: has no deployment {number}; it may be 0 to {after}, the next one")
        try:
            residual = read_model(self.folder, number, self.nominal.space, self.nominal)
        except (ValueError, OSError) as error:
            raise InputError(message_of(error)) from None
        log = Steps(self.steps.space) + self.known + self.steps.before(number)
        if residual is None and number < after and len(log):
            raise InputError(f"{self.folder}: there is no models/iteration_{number}.json, so the model is unknown")
        return Learner.start(self.nominal, log, self.settings.learning, number, residual)

    def corrected(self, iteration: int | None = None) -> CorrectedMap:
        """The map with which a deployment began: nominal map and residual.

        Args:
            iteration: As of `learner`.

        Raises:
            InputError: As of `learner`.
        """
        return self.learner(iteration).step_map()

    def controller(self, iteration: int | None = None) -> DeploymentController:
        """The controller at the start of a deployment; with the steps of the run it gives the recorded commands.

        Args:
            iteration: As of `learner`.

        Raises:
            InputError: As of `learner`.
        """
        return DeploymentController.start(self.learner(iteration), self.settings.control)


def load_run(folder: Path | str) -> LoadedRun:
    """Reads a run with its nominal map.

    Args:
        folder: The run folder.

    Raises:
        InputError: It is not a run, or a file in it is not valid; the message names it.
    """
    folder = Path(folder)
    settings = read_experiment(folder / "experiment.toml")
    nominal = load_nominal(settings).map
    try:
        steps = read_step_log(folder / "steps.csv", nominal.space)
    except (ValueError, OSError) as error:
        raise InputError(f"{message_of(error)}; {folder} must be the folder of a run") from None
    return LoadedRun(folder, settings, nominal, steps, as_past(load_known(settings, nominal.space)))
